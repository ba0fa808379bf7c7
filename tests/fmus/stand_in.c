/* A program for Windows in place of the Python behind an FMU: answers steps with their end [ticks] and its process number.
   The environment variable MISHAP says what it does at its second step: exit, stall, or refuse. */

#include <fcntl.h>
#include <io.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <windows.h>

static int received(void *bytes, size_t n) { return fread(bytes, 1, n, stdin) == n; }

static void answer(char kind, const void *bytes, uint32_t n) {
  fwrite(&kind, 1, 1, stdout);
  fwrite(&n, 1, sizeof n, stdout);
  fwrite(bytes, 1, n, stdout);
  fflush(stdout);
}

int main(void) {
  const char *mishap = getenv("MISHAP") ? getenv("MISHAP") : "";
  static char content[1 << 20];
  char kind;
  uint32_t n;
  int steps = 0;
  _setmode(0, _O_BINARY);
  _setmode(1, _O_BINARY);
  while (received(&kind, 1) && received(&n, sizeof n) && n <= sizeof content && received(content, n)) {
    int64_t times[2];
    double values[2];
    if (kind != 's') {
      answer('+', "", 0);
      continue;
    }
    if (++steps == 2 && !strcmp(mishap, "exit")) {
      fprintf(stderr, "the battery is empty\n");
      return 5;
    }
    if (steps == 2 && !strcmp(mishap, "stall")) Sleep(INFINITE);
    if (steps == 2 && !strcmp(mishap, "refuse")) {
      answer('-', "the road ends here", 18);
      continue;
    }
    memcpy(times, content, sizeof times);
    values[0] = (double)(times[0] + times[1]);
    values[1] = (double)GetCurrentProcessId();
    answer('+', values, sizeof values);
  }
  return 0;
}
