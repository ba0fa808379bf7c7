/* FMI 3.0 for co-simulation; the functions that it does not need are written at export, as fmi3_unused.c. */

#include <stdlib.h>
#include <string.h>

#include "instance.h"

#include "fmi3Functions.h"

#define DONE(failed) ((failed) ? fmi3Error : fmi3OK)

typedef struct {
  fmi3LogMessageCallback log;
  fmi3Boolean logs;
} Memory;

static void to_importer(Model *model, Severity severity, const char *message) {
  const Memory *memory = model->more;
  if (severity == INFORMATION && !memory->logs) return;
  if (memory->log)
    memory->log(model->environment, severity == REFUSAL ? fmi3Error : fmi3OK,
                severity == REFUSAL ? "logStatusError" : "logAll", message);
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
  (void)n;
  (void)categories;
  ((Memory *)((Model *)c)->more)->logs = on;
  return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logs, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate[], size_t n_intermediate,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
  Model *model = model_new(name, resources);
  Memory *memory;
  (void)visible, (void)event_mode, (void)early_return;
  (void)intermediate, (void)n_intermediate, (void)update;
  if (!model) return NULL;
  memory = calloc(1, sizeof *memory);
  if (!memory) {
    model_free(model);
    return NULL;
  }
  memory->log = log;
  memory->logs = logs;
  model->more = memory;
  model->environment = environment;
  model->log = to_importer;
  if (!token || strcmp(token, TOKEN)) {
    model_refuse(model, "the instantiation token is not that of this FMU, which is " TOKEN);
    model_free(model);
    return NULL;
  }
  return model;
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

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[],
                          size_t n_values) {
  if (n != n_values) {
    model_refuse(c, "%lu values for %lu scalars", (unsigned long)n_values, (unsigned long)n);
    return fmi3Error;
  }
  for (size_t i = 0; i < n; i++)
    if (model_get(c, vr[i], value + i)) return fmi3Error;
  return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[],
                          size_t n_values) {
  if (n != n_values) {
    model_refuse(c, "%lu values for %lu scalars", (unsigned long)n_values, (unsigned long)n);
    return fmi3Error;
  }
  for (size_t i = 0; i < n; i++)
    if (model_set(c, vr[i], value[i])) return fmi3Error;
  return fmi3OK;
}

fmi3Status fmi3GetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3String value[], size_t n_values) {
  if (n != n_values) {
    model_refuse(c, "%lu values for %lu texts", (unsigned long)n_values, (unsigned long)n);
    return fmi3Error;
  }
  for (size_t i = 0; i < n; i++)
    if (model_get_text(c, vr[i], value + i)) return fmi3Error;
  return fmi3OK;
}

fmi3Status fmi3SetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3String value[],
                         size_t n_values) {
  if (n != n_values) {
    model_refuse(c, "%lu values for %lu texts", (unsigned long)n_values, (unsigned long)n);
    return fmi3Error;
  }
  for (size_t i = 0; i < n; i++)
    if (model_set_text(c, vr[i], value[i])) return fmi3Error;
  return fmi3OK;
}

/* true, with a message, if the model's state cannot be taken */
static int keeps_none(Model *model) {
  if (model_state_size()) return 0;
  model_refuse(model, "the state of this FMU cannot be taken or set: it is in another process");
  return 1;
}

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) {
  if (keeps_none(c)) return fmi3Error;
  if (!*state) *state = malloc(model_state_size());
  if (!*state) return fmi3Error;
  memcpy(*state, ((Model *)c)->data, model_state_size());
  return fmi3OK;
}
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) {
  if (keeps_none(c)) return fmi3Error;
  return DONE(model_restore(c, state, model_state_size()));
}
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) {
  (void)c;
  free(*state);
  *state = NULL;
  return fmi3OK;
}
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size) {
  (void)state;
  *size = model_state_size();
  return DONE(keeps_none(c));
}
fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
  if (keeps_none(c)) return fmi3Error;
  if (!state || size < model_state_size()) {
    model_refuse(c, "a state needs %lu bytes", (unsigned long)model_state_size());
    return fmi3Error;
  }
  memcpy(bytes, state, model_state_size());
  return fmi3OK;
}
fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
  if (keeps_none(c)) return fmi3Error;
  if (size != model_state_size()) {
    model_refuse(c, "%lu bytes are no state of this model, which has %lu", (unsigned long)size,
                 (unsigned long)model_state_size());
    return fmi3Error;
  }
  if (!*state) *state = malloc(size);
  if (!*state) return fmi3Error;
  memcpy(*state, bytes, size);
  return fmi3OK;
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
