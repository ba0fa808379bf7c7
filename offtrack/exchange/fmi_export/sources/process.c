/* Processes on Linux: a pair of sockets is standard input and output of the process.

   The pair has no port that others could connect to, its end is noticed on both sides, also after a kill, and a write to a
   dead process is an error here and no signal. */

#define _GNU_SOURCE
#include "process.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

extern char **environ;

#define TAIL 2000  /* of the output that is searched for its last line [bytes] */
#define POLITE 5.0 /* time for an orderly end [s] */
#define LONGEST_LINE 300

struct Process {
  pid_t pid;
  int ended;  /* 1: waited for */
  int status; /* of the ended process */
  int socket;
  FILE *errors; /* what it prints */
};

double process_clock(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void rest(void) {
  struct timespec pause = {0, 2000000};
  nanosleep(&pause, NULL);
}

/* above the standard streams, which the host may have closed, and closed in all processes that it starts */
static int out_of_the_way(int descriptor) {
  int moved = descriptor;
  if (descriptor >= 0 && descriptor < 3) {
    moved = fcntl(descriptor, F_DUPFD_CLOEXEC, 3);
    close(descriptor);
  }
  if (moved >= 0) fcntl(moved, F_SETFD, FD_CLOEXEC);
  return moved;
}

static int spawned(Process *process, int other, const char *python, char *const *arguments) {
  posix_spawn_file_actions_t files;
  posix_spawnattr_t attributes;
  sigset_t none, all;
  int failed, errors = fileno(process->errors);
  sigemptyset(&none);
  sigfillset(&all);
  sigdelset(&all, SIGKILL);
  sigdelset(&all, SIGSTOP);
  posix_spawn_file_actions_init(&files);
  posix_spawn_file_actions_adddup2(&files, other, 0);
  posix_spawn_file_actions_adddup2(&files, other, 1);
  posix_spawn_file_actions_adddup2(&files, errors, 2);
  posix_spawnattr_init(&attributes);
  posix_spawnattr_setpgroup(&attributes, 0); /* Ctrl-C is for the host, which ends the process itself */
  posix_spawnattr_setsigmask(&attributes, &none);
  posix_spawnattr_setsigdefault(&attributes, &all);
  posix_spawnattr_setflags(&attributes,
                           POSIX_SPAWN_SETPGROUP | POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
  failed = posix_spawnp(&process->pid, python, &files, &attributes, arguments, environ);
  posix_spawnattr_destroy(&attributes);
  posix_spawn_file_actions_destroy(&files);
  return failed;
}

Process *process_start(const char *python, const char *module, const char *argument, char *reason, size_t size) {
  char *arguments[] = {(char *)python, "-m", (char *)module, (char *)argument, NULL};
  Process *process = calloc(1, sizeof *process);
  int pair[2] = {-1, -1}, failed;
  if (!process) return NULL;
  process->errors = tmpfile();
  if (!process->errors || socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair)) {
    snprintf(reason, size, "no socket or temporary file for it: %s", strerror(errno));
    if (process->errors) fclose(process->errors);
    free(process);
    return NULL;
  }
  fcntl(fileno(process->errors), F_SETFD, FD_CLOEXEC);
  pair[0] = out_of_the_way(pair[0]);
  pair[1] = out_of_the_way(pair[1]);
  failed = spawned(process, pair[1], python, arguments);
  close(pair[1]);
  process->socket = pair[0];
  if (failed) {
    snprintf(reason, size, "'%s' cannot be started: %s", python, strerror(failed));
    process->ended = 1;
    process_end(process, 1);
    return NULL;
  }
  return process;
}

/* true if the process ends in time; a host that waits for all children itself may be quicker */
static int ends(Process *process, double until) {
  while (!process->ended) {
    pid_t found = waitpid(process->pid, &process->status, WNOHANG);
    if (found == process->pid || (found < 0 && errno != EINTR)) {
      process->ended = found == process->pid ? 1 : 2;
    } else if (process_clock() > until) {
      return 0;
    } else {
      rest();
    }
  }
  return 1;
}

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

static void death(Process *process, char *reason, size_t size) {
  char tail[TAIL + 1];
  int errors = fileno(process->errors);
  off_t length;
  ssize_t n;
  if (!ends(process, process_clock() + POLITE))
    snprintf(reason, size, "it closed the connection");
  else if (process->ended == 1 && WIFSIGNALED(process->status))
    snprintf(reason, size, "it was ended by signal %d (%s)", WTERMSIG(process->status),
             strsignal(WTERMSIG(process->status)));
  else if (process->ended == 1)
    snprintf(reason, size, "it exited with code %d", WEXITSTATUS(process->status));
  else
    snprintf(reason, size, "it ended");
  length = lseek(errors, 0, SEEK_END);
  n = pread(errors, tail, TAIL, length > TAIL ? length - TAIL : 0);
  if (n > 0) add_last_line(tail, (size_t)n, reason, size);
}

/* waits until the socket is ready; 0, or 1 with a reason */
static int waits(Process *process, short events, double until, char *reason, size_t size) {
  for (;;) {
    struct pollfd one = {process->socket, events, 0};
    double left = until - process_clock();
    int n = poll(&one, 1, left > 0.0 ? (left < 1e6 ? (int)(left * 1e3) + 1 : 1000000000) : 0);
    if (n > 0) return 0;
    if (n < 0 && errno != EINTR) {
      snprintf(reason, size, "the connection to it failed: %s", strerror(errno));
      return 1;
    }
    if (n == 0 && process_clock() >= until) {
      snprintf(reason, size, "it does not answer in time");
      return 1;
    }
  }
}

static int moved(Process *process, int sending, char *next, size_t n, double until, char *reason, size_t size) {
  while (n > 0) {
    ssize_t done;
    if (waits(process, sending ? POLLOUT : POLLIN, until, reason, size)) return 1;
    done = sending ? send(process->socket, next, n, MSG_NOSIGNAL | MSG_DONTWAIT)
                   : recv(process->socket, next, n, MSG_DONTWAIT);
    if (done < 0 && (errno == EINTR || errno == EAGAIN || errno == EWOULDBLOCK)) continue;
    if (done <= 0) {
      death(process, reason, size);
      return 1;
    }
    next += done;
    n -= (size_t)done;
  }
  return 0;
}

int process_send(Process *process, const void *bytes, size_t n, double until, char *reason, size_t size) {
  return moved(process, 1, (char *)bytes, n, until, reason, size);
}

int process_receive(Process *process, void *bytes, size_t n, double until, char *reason, size_t size) {
  return moved(process, 0, bytes, n, until, reason, size);
}

void process_end(Process *process, int at_once) {
  if (!process) return;
  close(process->socket); /* the process ends when its input does */
  if (!process->ended && (at_once || !ends(process, process_clock() + POLITE)) && !ends(process, 0.0)) {
    kill(process->pid, SIGKILL);
    ends(process, process_clock() + POLITE);
  }
  fclose(process->errors);
  free(process);
}
