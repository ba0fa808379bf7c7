/* The last line of what a process printed. */

#ifndef OFFTRACK_PROCESS_COMMON_H
#define OFFTRACK_PROCESS_COMMON_H

#include <stdio.h>
#include <string.h>

#define TAIL 2000       /* of the output that is searched [bytes] */
#define POLITE 5.0      /* time for an orderly end [s] */
#define LONGEST_LINE 300

/* adds `` (it said: ...)`` to a reason */
static void add_last_line(char *text, size_t n, char *reason, size_t size) {
  size_t end = n, begin, used = strlen(reason);
  while (end > 0 && (unsigned char)text[end - 1] <= ' ') end--;
  text[end] = 0;
  for (begin = end; begin > 0 && text[begin - 1] != '\n' && text[begin - 1] != '\r';) begin--;
  while (text[begin] == ' ') begin++;
  if (end > begin && used < size)
    snprintf(reason + used, size - used, " (it said: %.*s)", LONGEST_LINE, text + begin);
}

#endif
