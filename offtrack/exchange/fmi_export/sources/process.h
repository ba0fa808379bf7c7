/* A Python process that computes for an instance: started, asked with a time limit, ended. */

#ifndef OFFTRACK_PROCESS_H
#define OFFTRACK_PROCESS_H

#include <stddef.h>

#include "portable.h"

typedef struct Process Process;

/* Starts ``python -m module argument``; NULL with a reason. */
HIDDEN Process *process_start(const char *python, const char *module, const char *argument, char *reason, size_t size);

/* Sends all bytes, or receives as many, before a time on ``process_clock``; 0, or 1 with a reason. */
HIDDEN int process_send(Process *process, const void *bytes, size_t n, double until, char *reason, size_t size);
HIDDEN int process_receive(Process *process, void *bytes, size_t n, double until, char *reason, size_t size);

/* Ends the process, at first politely, and frees everything; with ``at_once`` it is killed. */
HIDDEN void process_end(Process *process, int at_once);

HIDDEN double process_clock(void); /* monotonic [s] */

#endif
