/* A host that is no Python: loads the library of an FMU of version 2 or 3 and drives it.

   host LIBRARY VERSION TOKEN [RESOURCES]

   From standard input it reads numbers: length of a step [s]; number of steps; number of start values, then reference and
   value of each; number of inputs, then their references; number of outputs, then their references; number of texts that
   are set before the start, then reference and text of each, without blanks; then the inputs of every step. It prints the
   outputs before the first and after every step, a line each. */

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"
#include "fmi3FunctionTypes.h"

#ifdef _WIN32
#include <windows.h>
typedef HMODULE Library;
#define OPENED(path) LoadLibraryA(path)
#define SYMBOL(library, name) ((void *)GetProcAddress(library, name))
#else
#include <dlfcn.h>
typedef void *Library;
#define OPENED(path) dlopen(path, RTLD_NOW | RTLD_LOCAL)
#define SYMBOL(library, name) dlsym(library, name)
#endif

#define FUNCTION(name) name##TYPE *name = (name##TYPE *)SYMBOL(library, #name)
#define MUST(call) do { if ((call) != 0) { fprintf(stderr, "%s failed\n", #call); exit(1); } } while (0)

typedef struct {
  unsigned count, *references;
  double *values;
} Values;

static double step_length;
static unsigned n_steps, text_count, text_references[8];
static char texts[8][512];
static Values starts, inputs, outputs;

static void log_2(fmi2ComponentEnvironment e, fmi2String n, fmi2Status s, fmi2String c, fmi2String m, ...) {
  va_list arguments;
  va_start(arguments, m);
  vfprintf(stderr, m, arguments);
  fputc('\n', stderr);
  va_end(arguments);
}
static void log_3(fmi3InstanceEnvironment e, fmi3Status s, fmi3String c, fmi3String m) { fprintf(stderr, "%s\n", m); }

static double number(void) {
  double value = 0.0;
  if (scanf("%lf", &value) != 1) {
    fprintf(stderr, "a number is missing\n");
    exit(1);
  }
  return value;
}

static void read_values(Values *of, int with_values) {
  of->count = (unsigned)number();
  of->references = calloc(of->count + 1, sizeof *of->references);
  of->values = calloc(of->count + 1, sizeof *of->values);
  for (unsigned k = 0; k < of->count; k++) {
    of->references[k] = (unsigned)number();
    if (with_values) of->values[k] = number();
  }
}

static void read_experiment(void) {
  step_length = number();
  n_steps = (unsigned)number();
  read_values(&starts, 1);
  read_values(&inputs, 0);
  read_values(&outputs, 0);
  text_count = (unsigned)number();
  for (unsigned k = 0; k < text_count; k++) {
    text_references[k] = (unsigned)number();
    if (scanf("%511s", texts[k]) != 1) exit(1);
  }
}

static void read_inputs(void) {
  for (unsigned k = 0; k < inputs.count; k++) inputs.values[k] = number();
}

static void print_outputs(void) {
  for (unsigned k = 0; k < outputs.count; k++) printf("%.17g ", outputs.values[k]);
  printf("\n");
}

static void run_2(Library library, const char *token, const char *resources) {
  fmi2CallbackFunctions callbacks = {log_2, calloc, free, NULL, NULL};
  FUNCTION(fmi2Instantiate); FUNCTION(fmi2SetupExperiment); FUNCTION(fmi2EnterInitializationMode);
  FUNCTION(fmi2ExitInitializationMode); FUNCTION(fmi2SetReal); FUNCTION(fmi2GetReal); FUNCTION(fmi2SetString);
  FUNCTION(fmi2DoStep); FUNCTION(fmi2Terminate); FUNCTION(fmi2FreeInstance);
  fmi2Component c = fmi2Instantiate("host", fmi2CoSimulation, token, resources, &callbacks, 0, 0);
  MUST(!c);
  MUST(fmi2SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0));
  MUST(fmi2EnterInitializationMode(c));
  MUST(fmi2SetReal(c, starts.references, starts.count, starts.values));
  for (unsigned k = 0; k < text_count; k++) {
    const char *text = texts[k];
    MUST(fmi2SetString(c, text_references + k, 1, &text));
  }
  MUST(fmi2ExitInitializationMode(c));
  for (unsigned k = 0; k <= n_steps; k++) {
    MUST(fmi2GetReal(c, outputs.references, outputs.count, outputs.values));
    print_outputs();
    if (k == n_steps) break;
    read_inputs();
    MUST(fmi2SetReal(c, inputs.references, inputs.count, inputs.values));
    MUST(fmi2DoStep(c, step_length * k, step_length, 1));
  }
  MUST(fmi2Terminate(c));
  fmi2FreeInstance(c);
}

static void run_3(Library library, const char *token, const char *resources) {
  FUNCTION(fmi3InstantiateCoSimulation); FUNCTION(fmi3EnterInitializationMode); FUNCTION(fmi3ExitInitializationMode);
  FUNCTION(fmi3SetFloat64); FUNCTION(fmi3GetFloat64); FUNCTION(fmi3SetString); FUNCTION(fmi3DoStep);
  FUNCTION(fmi3Terminate); FUNCTION(fmi3FreeInstance);
  fmi3Boolean event, terminate, early;
  double last;
  fmi3Instance c = fmi3InstantiateCoSimulation("host", token, resources, 0, 0, 0, 0, NULL, 0, NULL, log_3, NULL);
  MUST(!c);
  MUST(fmi3EnterInitializationMode(c, 0, 0.0, 0.0, 0, 0.0));
  MUST(fmi3SetFloat64(c, starts.references, starts.count, starts.values, starts.count));
  for (unsigned k = 0; k < text_count; k++) {
    const char *text = texts[k];
    MUST(fmi3SetString(c, text_references + k, 1, &text, 1));
  }
  MUST(fmi3ExitInitializationMode(c));
  for (unsigned k = 0; k <= n_steps; k++) {
    MUST(fmi3GetFloat64(c, outputs.references, outputs.count, outputs.values, outputs.count));
    print_outputs();
    if (k == n_steps) break;
    read_inputs();
    MUST(fmi3SetFloat64(c, inputs.references, inputs.count, inputs.values, inputs.count));
    MUST(fmi3DoStep(c, step_length * k, step_length, 1, &event, &terminate, &early, &last));
  }
  MUST(fmi3Terminate(c));
  fmi3FreeInstance(c);
}

int main(int n, char **v) {
  Library library = n >= 4 ? OPENED(v[1]) : NULL;
  if (!library) {
    fprintf(stderr, "%s\n", n >= 4 ? "the library cannot be loaded" : "three arguments are needed");
    return 1;
  }
  read_experiment();
  (atoi(v[2]) == 2 ? run_2 : run_3)(library, v[3], n > 4 ? v[4] : NULL);
  return 0;
}
