/* Processes on Windows: two pipes are standard input and output of the process. */

#ifdef _WIN32

#define WIN32_LEAN_AND_MEAN
#ifndef _WIN32_WINNT
#define _WIN32_WINNT 0x0601
#endif
#include <windows.h>

#include "process.h"
#include "process_common.h"

#include <stdlib.h>

#define LONGEST_COMMAND 32000 /* characters */

struct Process {
  HANDLE process, job, to, from, errors; /* the job ends the process together with the host */
};

double process_clock(void) {
  LARGE_INTEGER count, frequency;
  QueryPerformanceCounter(&count);
  QueryPerformanceFrequency(&frequency);
  return (double)count.QuadPart / (double)frequency.QuadPart;
}

static void closed(HANDLE *handle) {
  if (*handle && *handle != INVALID_HANDLE_VALUE) CloseHandle(*handle);
  *handle = NULL;
}

/* a pipe whose end ``theirs`` the process inherits */
static int opened(HANDLE *reads, HANDLE *writes, HANDLE *theirs) {
  SECURITY_ATTRIBUTES none = {sizeof none, NULL, FALSE};
  if (!CreatePipe(reads, writes, &none, 1 << 20)) return 0;
  return SetHandleInformation(*theirs, HANDLE_FLAG_INHERIT, HANDLE_FLAG_INHERIT);
}

static HANDLE temporary(void) {
  char folder[MAX_PATH + 1], name[MAX_PATH + 1];
  SECURITY_ATTRIBUTES inherited = {sizeof inherited, NULL, TRUE};
  if (!GetTempPathA(sizeof folder, folder) || !GetTempFileNameA(folder, "off", 0, name)) return INVALID_HANDLE_VALUE;
  return CreateFileA(name, GENERIC_READ | GENERIC_WRITE, FILE_SHARE_READ | FILE_SHARE_WRITE | FILE_SHARE_DELETE,
                     &inherited, CREATE_ALWAYS, FILE_ATTRIBUTE_TEMPORARY | FILE_FLAG_DELETE_ON_CLOSE, NULL);
}

/* only these handles are inherited: another thread may be starting another process */
static int spawned(Process *process, HANDLE *theirs, char *command) {
  STARTUPINFOEXA start;
  PROCESS_INFORMATION information;
  JOBOBJECT_EXTENDED_LIMIT_INFORMATION limits;
  SIZE_T size = 0;
  int done = 0;
  memset(&start, 0, sizeof start);
  memset(&limits, 0, sizeof limits);
  start.StartupInfo.cb = sizeof start;
  start.StartupInfo.dwFlags = STARTF_USESTDHANDLES;
  start.StartupInfo.hStdInput = theirs[0];
  start.StartupInfo.hStdOutput = theirs[1];
  start.StartupInfo.hStdError = theirs[2];
  InitializeProcThreadAttributeList(NULL, 1, 0, &size);
  start.lpAttributeList = malloc(size);
  if (!start.lpAttributeList) return 0;
  if (InitializeProcThreadAttributeList(start.lpAttributeList, 1, 0, &size)) {
    if (UpdateProcThreadAttribute(start.lpAttributeList, 0, PROC_THREAD_ATTRIBUTE_HANDLE_LIST, theirs,
                                  3 * sizeof *theirs, NULL, NULL))
      done = CreateProcessA(NULL, command, NULL, NULL, TRUE,
                            EXTENDED_STARTUPINFO_PRESENT | CREATE_NO_WINDOW | CREATE_NEW_PROCESS_GROUP, NULL, NULL,
                            &start.StartupInfo, &information);
    DeleteProcThreadAttributeList(start.lpAttributeList);
  }
  free(start.lpAttributeList);
  if (!done) return 0;
  CloseHandle(information.hThread);
  process->process = information.hProcess;
  process->job = CreateJobObjectA(NULL, NULL);
  limits.BasicLimitInformation.LimitFlags = JOB_OBJECT_LIMIT_KILL_ON_JOB_CLOSE;
  SetInformationJobObject(process->job, JobObjectExtendedLimitInformation, &limits, sizeof limits);
  AssignProcessToJobObject(process->job, process->process);
  return 1;
}

Process *process_start(const char *python, const char *module, const char *argument, char *reason, size_t size) {
  Process *process = calloc(1, sizeof *process);
  char *command = malloc(LONGEST_COMMAND);
  HANDLE theirs[3] = {NULL, NULL, NULL};
  int done = 0;
  if (process && command) {
    snprintf(command, LONGEST_COMMAND, "\"%s\" -m %s \"%s\"", python, module, argument);
    theirs[2] = process->errors = temporary();
    done = opened(&theirs[0], &process->to, &theirs[0]) && opened(&process->from, &theirs[1], &theirs[1]) &&
           spawned(process, theirs, command);
    if (!done) snprintf(reason, size, "'%s' cannot be started: error %lu of Windows", python, GetLastError());
    closed(&theirs[0]);
    closed(&theirs[1]);
  }
  free(command);
  if (done) return process;
  process_end(process, 1);
  return NULL;
}

static void death(Process *process, char *reason, size_t size) {
  char tail[TAIL + 1];
  DWORD code = 0, n = 0;
  LONG length = (LONG)GetFileSize(process->errors, NULL);
  if (WaitForSingleObject(process->process, (DWORD)(POLITE * 1e3)) == WAIT_OBJECT_0 &&
      GetExitCodeProcess(process->process, &code))
    snprintf(reason, size, "it exited with code %lu", code);
  else
    snprintf(reason, size, "it closed the connection");
  SetFilePointer(process->errors, length > TAIL ? length - TAIL : 0, NULL, FILE_BEGIN);
  if (ReadFile(process->errors, tail, TAIL, &n, NULL) && n) add_last_line(tail, n, reason, size);
}

int process_send(Process *process, const void *bytes, size_t n, double until, char *reason, size_t size) {
  const char *next = bytes;
  (void)until; /* a request is smaller than the pipe, which is empty */
  while (n > 0) {
    DWORD sent = 0;
    if (!WriteFile(process->to, next, (DWORD)n, &sent, NULL)) {
      death(process, reason, size);
      return 1;
    }
    next += sent;
    n -= sent;
  }
  return 0;
}

int process_receive(Process *process, void *bytes, size_t n, double until, char *reason, size_t size) {
  char *next = bytes;
  while (n > 0) {
    DWORD there = 0, got = 0;
    if (!PeekNamedPipe(process->from, NULL, 0, NULL, &there, NULL)) {
      death(process, reason, size);
      return 1;
    }
    if (!there) {
      if (process_clock() >= until) {
        snprintf(reason, size, "it does not answer in time");
        return 1;
      }
      Sleep(1);
      continue;
    }
    if (!ReadFile(process->from, next, (DWORD)(there < n ? there : n), &got, NULL)) {
      death(process, reason, size);
      return 1;
    }
    next += got;
    n -= got;
  }
  return 0;
}

void process_end(Process *process, int at_once) {
  if (!process) return;
  closed(&process->to); /* the process ends when its input does */
  if (process->process) {
    if (at_once || WaitForSingleObject(process->process, (DWORD)(POLITE * 1e3)) != WAIT_OBJECT_0) {
      TerminateProcess(process->process, 1);
      WaitForSingleObject(process->process, (DWORD)(POLITE * 1e3));
    }
  }
  closed(&process->process);
  closed(&process->job);
  closed(&process->from);
  closed(&process->errors);
  free(process);
}

#else
typedef int no_empty_file; /* C has no empty files */
#endif
