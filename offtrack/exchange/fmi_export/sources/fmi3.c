/* FMI 3.0 for co-simulation; the functions that it does not need are written at export, as fmi3_unused.c. */

#include <string.h>

#include "instance.h"

#include "fmi3Functions.h"

#define DONE(failed) ((failed) ? fmi3Error : fmi3OK)

static void to_importer(Model *model, const char *message) {
  fmi3LogMessageCallback log = (fmi3LogMessageCallback)model->callback;
  if (log) log(model->environment, fmi3Error, "logStatusError", message);
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
  (void)c, (void)on, (void)n, (void)categories; /* every message is the reason of a failure */
  return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logs, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate[], size_t n_intermediate,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
  Model begin = {.log = to_importer, .name = (char *)name, .resources = (char *)resources, .environment = environment};
  begin.callback = (void (*)(void))log;
  (void)visible, (void)logs, (void)event_mode, (void)early_return;
  (void)intermediate, (void)n_intermediate, (void)update;
  return model_new(begin, token);
}

void fmi3FreeInstance(fmi3Instance c) { model_free(c); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean has_tolerance, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop) {
  (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
  return DONE(model_begin(c, start));
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return DONE(model_initialise(c)); }
fmi3Status fmi3Terminate(fmi3Instance c) {
  model_terminate(c);
  return fmi3OK;
}
fmi3Status fmi3Reset(fmi3Instance c) {
  model_reset(c);
  return fmi3OK;
}

static int differ(Model *model, size_t n, size_t n_values) {
  if (n == n_values) return 0;
  return model_refuse(model, "%lu values for %lu scalars", (unsigned long)n_values, (unsigned long)n);
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[],
                          size_t n_values) {
  return DONE(differ(c, n, n_values) || model_get_all(c, vr, n, value));
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[],
                          size_t n_values) {
  return DONE(differ(c, n, n_values) || model_set_all(c, vr, n, value));
}
fmi3Status fmi3GetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3String value[],
                          size_t n_values) {
  return DONE(differ(c, n, n_values) || model_get_texts(c, vr, n, value));
}
fmi3Status fmi3SetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3String value[],
                          size_t n_values) {
  return DONE(differ(c, n, n_values) || model_set_texts(c, vr, n, value));
}

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) { return DONE(model_take(c, state)); }
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) {
  return DONE(model_restore(c, state, model_state_size()));
}
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) {
  (void)c;
  model_free_state(state);
  return fmi3OK;
}
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size) {
  (void)c, (void)state;
  *size = model_state_size();
  return DONE(!*size);
}
fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
  return DONE(model_write_state(c, state, bytes, size));
}
fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
  return DONE(model_read_state(c, bytes, size, state));
}

fmi3Status fmi3EnterStepMode(fmi3Instance c) {
  (void)c;
  return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 step, fmi3Boolean no_set_state,
                      fmi3Boolean *event_needed, fmi3Boolean *terminate, fmi3Boolean *early_return,
                      fmi3Float64 *last_time) {
  int failed = model_step(c, time, step);
  (void)no_set_state;
  *event_needed = *terminate = *early_return = fmi3False;
  model_get(c, 0, last_time);
  return DONE(failed);
}
