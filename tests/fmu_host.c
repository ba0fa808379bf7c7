/* A host that is no Python: loads the library of an FMU, makes one or more steps of 10 ms with 0.1 for an input, prints an output.
   host LIBRARY VERSION TOKEN REFERENCE_OF_INPUT REFERENCE_OF_OUTPUT [RESOURCES STEPS] */

#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi2FunctionTypes.h"
#include "fmi3FunctionTypes.h"

static void log_2(fmi2ComponentEnvironment e, fmi2String n, fmi2Status s, fmi2String c, fmi2String m, ...) {
  fprintf(stderr, "%s %d %s %s\n", n, s, c, m);
}
static void log_3(fmi3InstanceEnvironment e, fmi3Status s, fmi3String c, fmi3String m) {
  fprintf(stderr, "%d %s %s\n", s, c, m);
}

#define FUNCTION(name) name##TYPE *name = (name##TYPE *)dlsym(library, #name)
#define MUST(call) do { if ((call) != 0) { fprintf(stderr, "%s failed\n", #call); return 1; } } while (0)

static int run_2(void *library, const char *token, const char *resources, int steps, unsigned steer, unsigned output, double *value) {
  fmi2CallbackFunctions callbacks = {log_2, calloc, free, NULL, NULL};
  FUNCTION(fmi2Instantiate); FUNCTION(fmi2SetupExperiment); FUNCTION(fmi2EnterInitializationMode);
  FUNCTION(fmi2ExitInitializationMode); FUNCTION(fmi2SetReal); FUNCTION(fmi2GetReal); FUNCTION(fmi2DoStep);
  FUNCTION(fmi2FreeInstance);
  double angle = 0.1;
  fmi2Component c = fmi2Instantiate("host", fmi2CoSimulation, token, resources, &callbacks, 0, 0);
  if (!c) return 1;
  MUST(fmi2SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0));
  MUST(fmi2EnterInitializationMode(c));
  MUST(fmi2ExitInitializationMode(c));
  MUST(fmi2SetReal(c, &steer, 1, &angle));
  for (int k = 0; k < steps; k++) MUST(fmi2DoStep(c, 0.01 * k, 0.01, 1));
  MUST(fmi2GetReal(c, &output, 1, value));
  fmi2FreeInstance(c);
  return 0;
}

static int run_3(void *library, const char *token, const char *resources, int steps, unsigned steer, unsigned output, double *value) {
  FUNCTION(fmi3InstantiateCoSimulation); FUNCTION(fmi3EnterInitializationMode); FUNCTION(fmi3ExitInitializationMode);
  FUNCTION(fmi3SetFloat64); FUNCTION(fmi3GetFloat64); FUNCTION(fmi3DoStep); FUNCTION(fmi3FreeInstance);
  double angle = 0.1, last;
  fmi3Boolean event, terminate, early;
  fmi3Instance c = fmi3InstantiateCoSimulation("host", token, resources, 0, 0, 0, 0, NULL, 0, NULL, log_3, NULL);
  if (!c) return 1;
  MUST(fmi3EnterInitializationMode(c, 0, 0.0, 0.0, 0, 0.0));
  MUST(fmi3ExitInitializationMode(c));
  MUST(fmi3SetFloat64(c, &steer, 1, &angle, 1));
  for (int k = 0; k < steps; k++) MUST(fmi3DoStep(c, 0.01 * k, 0.01, 1, &event, &terminate, &early, &last));
  MUST(fmi3GetFloat64(c, &output, 1, value, 1));
  fmi3FreeInstance(c);
  return 0;
}

int main(int n, char **v) {
  void *library = n >= 6 ? dlopen(v[1], RTLD_NOW | RTLD_LOCAL) : NULL;
  double value = 0.0;
  unsigned steer = n >= 6 ? atoi(v[4]) : 0, output = n >= 6 ? atoi(v[5]) : 0;
  if (!library) {
    fprintf(stderr, "%s\n", n >= 6 ? dlerror() : "five arguments are needed");
    return 1;
  }
  if ((atoi(v[2]) == 2 ? run_2 : run_3)(library, v[3], n > 7 ? v[6] : NULL, n > 7 ? atoi(v[7]) : 1, steer, output, &value)) return 1;
  printf("%.17g\n", value);
  return 0;
}
