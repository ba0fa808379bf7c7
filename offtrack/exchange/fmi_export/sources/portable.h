/* What compilers call differently. */

#ifndef OFFTRACK_PORTABLE_H
#define OFFTRACK_PORTABLE_H

#if defined(_MSC_VER) && !defined(__clang__)
#define restrict __restrict
#define __attribute__(x)
#endif

/* functions between the files of this FMU, which no other library in the process may replace */
#if defined(__GNUC__) && !defined(_WIN32)
#define HIDDEN __attribute__((visibility("hidden")))
#else
#define HIDDEN
#endif

#endif
