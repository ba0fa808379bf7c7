/* Functions of a small FMU. The including source defines VERSION (2 or 3), N variables with their STARTS, the places
   MISHAP, AT and OUTPUT of some of them, TOKEN, and CODE that computes v[] and may keep x[]. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <stdio.h>
#include <signal.h>
#include <unistd.h>
typedef struct { double v[N]; double x[16]; } Model;
static double starts[N] = { STARTS };
static double deep(double x) {
    volatile char filled[4096];
    filled[0] = (char)x;
    return deep(x + filled[0]) + filled[0];
}
static void ended(Model *m) {
    if (m->v[MISHAP] == 23) *(volatile int *)8 = 1;
    if (m->v[MISHAP] == 24) for (;;) usleep(1000);
    free(m);
}
static int computed(Model *m, double time, double dt) {
    double *v = m->v, *x = m->x;
    (void)x;
    (void)dt;
    const int due = dt > 0 && time >= v[AT] - 1e-9, mishap = (int)v[MISHAP];
    if (due) switch (mishap) {
        case 1: *(volatile int *)8 = 1; break;
        case 2: for (;;) usleep(1000);
        case 3: v[OUTPUT] = NAN; return 0;
        case 4: fprintf(stderr, "the water is too cold\n"); return 3;
        case 5: exit(7);
        case 6: v[OUTPUT] = INFINITY; return 0;
        case 7: return 2;
        case 8: return 4;
        case 9: return 5;
        case 10: abort();
        case 11: exit(0);
        case 12: return (int)deep(1.0);
        case 13: kill(getpid(), SIGKILL);
        case 14: for (int k = 0; k < 64; k++) close(k); for (;;) usleep(1000);
        case 15: for (int k = 0; k < 20000; k++) printf("blah %d\n", k); fflush(stdout); return 3;
        case 16: for (int k = 0; k < 256; k++) fputc(k, stderr); return 3;
    }
    if (dt == 0) switch (mishap) {
        case 17: *(volatile int *)8 = 1; break;
        case 18: for (;;) usleep(1000);
        case 19: v[OUTPUT] = NAN; return 0;
        case 20: return 3;
        case 21: exit(9);
        case 22: return 2;
    }
    CODE
    return 0;
}
#define UNUSED(name) int name(void) { return 3; }
#if VERSION == 2
void *fmi2Instantiate(const char *n, int t, const char *g, const char *r, void *c, int vis, int log) {
    if (strcmp(g, TOKEN)) return 0;
    Model *m = calloc(1, sizeof(Model));
    memcpy(m->v, starts, sizeof starts);
    return m;
}
void fmi2FreeInstance(void *m) { ended(m); }
int fmi2SetupExperiment(void *m, int a, double b, double c, int d, double e) { return 0; }
int fmi2EnterInitializationMode(void *m) { return 0; }
int fmi2ExitInitializationMode(void *m) { return computed(m, 0, 0); }
int fmi2Terminate(void *m) { return 0; }
int fmi2SetReal(void *m, const unsigned *r, size_t n, const double *v) {
    for (size_t i = 0; i < n; i++) ((Model *)m)->v[r[i]] = v[i];
    return 0;
}
int fmi2GetReal(void *m, const unsigned *r, size_t n, double *v) {
    for (size_t i = 0; i < n; i++) v[i] = ((Model *)m)->v[r[i]];
    return 0;
}
UNUSED(fmi2GetTypesPlatform) UNUSED(fmi2GetVersion) UNUSED(fmi2SetDebugLogging) UNUSED(fmi2Reset)
UNUSED(fmi2GetInteger) UNUSED(fmi2GetBoolean) UNUSED(fmi2GetString) UNUSED(fmi2SetInteger) UNUSED(fmi2SetBoolean)
UNUSED(fmi2SetString) UNUSED(fmi2GetDirectionalDerivative) UNUSED(fmi2SetRealInputDerivatives)
UNUSED(fmi2GetRealOutputDerivatives) UNUSED(fmi2CancelStep) UNUSED(fmi2GetStatus) UNUSED(fmi2GetRealStatus)
UNUSED(fmi2GetIntegerStatus) UNUSED(fmi2GetBooleanStatus) UNUSED(fmi2GetStringStatus)
int fmi2DoStep(void *m, double t, double h, int k) { return computed(m, t, h); }
int fmi2GetFMUstate(void *m, void **s) { *s = malloc(sizeof(Model)); memcpy(*s, m, sizeof(Model)); return 0; }
int fmi2SetFMUstate(void *m, void *s) { memcpy(m, s, sizeof(Model)); return 0; }
int fmi2FreeFMUstate(void *m, void **s) { free(*s); *s = 0; return 0; }
int fmi2SerializedFMUstateSize(void *m, void *s, size_t *n) { *n = sizeof(Model); return 0; }
int fmi2SerializeFMUstate(void *m, void *s, char *b, size_t n) { memcpy(b, s, n); return 0; }
int fmi2DeSerializeFMUstate(void *m, const char *b, size_t n, void **s) { *s = malloc(n); memcpy(*s, b, n); return 0; }
#else
#include <stdbool.h>
void *fmi3InstantiateCoSimulation(const char *n, const char *t, const char *r, bool v, bool l, bool e, bool a,
                                  const unsigned *q, size_t nq, void *env, void *log, void *update) {
    Model *m = calloc(1, sizeof(Model));
    memcpy(m->v, starts, sizeof starts);
    return m;
}
void fmi3FreeInstance(void *m) { ended(m); }
int fmi3EnterInitializationMode(void *m, bool a, double b, double c, bool d, double e) { return 0; }
int fmi3ExitInitializationMode(void *m) { return computed(m, 0, 0); }
int fmi3Terminate(void *m) { return 0; }
int fmi3SetFloat64(void *m, const unsigned *r, size_t n, const double *v, size_t nv) {
    for (size_t i = 0; i < n; i++) ((Model *)m)->v[r[i]] = v[i];
    return 0;
}
int fmi3GetFloat64(void *m, const unsigned *r, size_t n, double *v, size_t nv) {
    for (size_t i = 0; i < n; i++) v[i] = ((Model *)m)->v[r[i]];
    return 0;
}
int fmi3DoStep(void *m, double t, double h, bool k, bool *event, bool *end, bool *early, double *last) {
    *event = *end = *early = false;
    *last = t + h;
    return computed(m, t, h);
}
int fmi3GetFMUState(void *m, void **s) { *s = malloc(sizeof(Model)); memcpy(*s, m, sizeof(Model)); return 0; }
int fmi3SetFMUState(void *m, void *s) { memcpy(m, s, sizeof(Model)); return 0; }
int fmi3FreeFMUState(void *m, void **s) { free(*s); *s = 0; return 0; }
int fmi3SerializedFMUStateSize(void *m, void *s, size_t *n) { *n = sizeof(Model); return 0; }
int fmi3SerializeFMUState(void *m, void *s, char *b, size_t n) { memcpy(b, s, n); return 0; }
int fmi3DeserializeFMUState(void *m, const char *b, size_t n, void **s) { *s = malloc(n); memcpy(*s, b, n); return 0; }
#endif
