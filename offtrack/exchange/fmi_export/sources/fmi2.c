/* FMI 2.0 for co-simulation. */

#include <stdlib.h>
#include <string.h>

#include "instance.h"

#include "fmi2Functions.h"

#define DONE(failed) ((failed) ? fmi2Error : fmi2OK)
#define NOTHING(n) DONE((n) > 0) /* of a type that no variable has */

typedef struct {
  fmi2Boolean logs;
} Memory;

static void to_importer(Model *model, Severity severity, const char *message) {
  const fmi2CallbackFunctions *callbacks = model->callback;
  if (severity == INFORMATION && !((Memory *)model->more)->logs) return;
  if (callbacks && callbacks->logger)
    callbacks->logger(model->environment, model->name, severity == REFUSAL ? fmi2Error : fmi2OK,
                      severity == REFUSAL ? "logStatusError" : "logAll", "%s", message);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
  (void)n;
  (void)categories;
  ((Memory *)((Model *)c)->more)->logs = on;
  return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logs) {
  Model *model = model_new(name, resources);
  (void)visible;
  if (!model) return NULL;
  model->more = calloc(1, sizeof(Memory));
  if (!model->more) {
    model_free(model);
    return NULL;
  }
  model->callback = (void *)callbacks;
  model->environment = callbacks ? callbacks->componentEnvironment : NULL;
  model->log = to_importer;
  ((Memory *)model->more)->logs = logs;
  if (type != fmi2CoSimulation || !guid || strcmp(guid, TOKEN)) {
    model_refuse(model, type != fmi2CoSimulation ? "this FMU is for co-simulation only"
                                                 : "the GUID is not that of this FMU, which is " TOKEN);
    model_free(model);
    return NULL;
  }
  return model;
}

void fmi2FreeInstance(fmi2Component c) { model_free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop) {
  (void)has_tolerance;
  (void)tolerance;
  (void)has_stop;
  (void)stop;
  return DONE(model_begin(c, start));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
  (void)c;
  return fmi2OK;
}
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return DONE(model_initialise(c)); }
fmi2Status fmi2Terminate(fmi2Component c) {
  model_terminate(c);
  return fmi2OK;
}
fmi2Status fmi2Reset(fmi2Component c) {
  model_reset(c);
  return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
  for (size_t i = 0; i < n; i++)
    if (model_get(c, vr[i], value + i)) return fmi2Error;
  return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
  for (size_t i = 0; i < n; i++)
    if (model_set(c, vr[i], value[i])) return fmi2Error;
  return fmi2OK;
}

#define WITHOUT(Type, type)                                                                                   \
  fmi2Status fmi2Get##Type(fmi2Component c, const fmi2ValueReference vr[], size_t n, type value[]) {          \
    (void)c, (void)vr, (void)value;                                                                           \
    return NOTHING(n);                                                                                        \
  }                                                                                                           \
  fmi2Status fmi2Set##Type(fmi2Component c, const fmi2ValueReference vr[], size_t n, const type value[]) {    \
    (void)c, (void)vr, (void)value;                                                                           \
    return NOTHING(n);                                                                                        \
  }
WITHOUT(Integer, fmi2Integer)
WITHOUT(Boolean, fmi2Boolean)

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
  for (size_t i = 0; i < n; i++)
    if (model_get_text(c, vr[i], value + i)) return fmi2Error;
  return fmi2OK;
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
  for (size_t i = 0; i < n; i++)
    if (model_set_text(c, vr[i], value[i])) return fmi2Error;
  return fmi2OK;
}

/* true, with a message, if the model's state cannot be taken */
static int keeps_none(Model *model) {
  if (model_state_size()) return 0;
  model_refuse(model, "the state of this FMU cannot be taken or set: it is in another process");
  return 1;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
  if (keeps_none(c)) return fmi2Error;
  if (!*state) *state = malloc(model_state_size());
  if (!*state) return fmi2Error;
  memcpy(*state, ((Model *)c)->data, model_state_size());
  return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
  if (keeps_none(c)) return fmi2Error;
  return DONE(model_restore(c, state, model_state_size()));
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
  (void)c;
  free(*state);
  *state = NULL;
  return fmi2OK;
}
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
  (void)state;
  *size = model_state_size();
  return DONE(keeps_none(c));
}
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
  if (keeps_none(c)) return fmi2Error;
  if (!state || size < model_state_size()) {
    model_refuse(c, "a state needs %lu bytes", (unsigned long)model_state_size());
    return fmi2Error;
  }
  memcpy(bytes, state, model_state_size());
  return fmi2OK;
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
  if (keeps_none(c)) return fmi2Error;
  if (size != model_state_size()) {
    model_refuse(c, "%lu bytes are no state of this model, which has %lu", (unsigned long)size,
                 (unsigned long)model_state_size());
    return fmi2Error;
  }
  if (!*state) *state = malloc(size);
  if (!*state) return fmi2Error;
  memcpy(*state, bytes, size);
  return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference of[], size_t n_of,
                                        const fmi2ValueReference by[], size_t n_by, const fmi2Real along[],
                                        fmi2Real result[]) {
  (void)of, (void)n_of, (void)by, (void)n_by, (void)along, (void)result;
  model_refuse(c, "this FMU has no directional derivatives");
  return fmi2Error;
}
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
  (void)c, (void)vr, (void)order, (void)value;
  return NOTHING(n);
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
  (void)c, (void)vr, (void)order, (void)value;
  return NOTHING(n);
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_return) {
  (void)no_return;
  return DONE(model_step(c, time, step));
}
fmi2Status fmi2CancelStep(fmi2Component c) {
  model_refuse(c, "no step is pending: steps are done when they return");
  return fmi2Error;
}

/* no step is ever pending, so that there is no status to ask for */
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
  (void)c, (void)kind, (void)value;
  return fmi2Discard;
}
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
  if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
  return DONE(model_get(c, 0, value));
}
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
  (void)c, (void)kind, (void)value;
  return fmi2Discard;
}
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
  (void)c;
  if (kind != fmi2Terminated) return fmi2Discard;
  *value = fmi2False;
  return fmi2OK;
}
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
  (void)c, (void)kind, (void)value;
  return fmi2Discard;
}
