/* FMI 2.0 for co-simulation. */

#include <string.h>

#include "instance.h"

#include "fmi2Functions.h"

#define DONE(failed) ((failed) ? fmi2Error : fmi2OK)
#define NOTHING(n) DONE((n) > 0) /* of a type that no variable has */

static void to_importer(Model *model, const char *message) {
  const fmi2CallbackFunctions *callbacks = model->callbacks;
  if (callbacks && callbacks->logger)
    callbacks->logger(model->environment, model->name, fmi2Error, "logStatusError", "%s", message);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
  (void)c, (void)on, (void)n, (void)categories; /* every message is the reason of a failure */
  return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logs) {
  Model begin = {.log = to_importer, .name = (char *)name, .resources = (char *)resources, .callbacks = callbacks};
  Model *model;
  (void)visible, (void)logs;
  begin.environment = callbacks ? callbacks->componentEnvironment : NULL;
  model = model_new(begin, guid);
  if (model && type != fmi2CoSimulation) {
    model_refuse(model, "this FMU is for co-simulation only");
    model_free(model);
    return NULL;
  }
  return model;
}

void fmi2FreeInstance(fmi2Component c) { model_free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop) {
  (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
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
  return DONE(model_get_all(c, vr, n, value));
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
  return DONE(model_set_all(c, vr, n, value));
}
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
  return DONE(model_get_texts(c, vr, n, value));
}
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
  return DONE(model_set_texts(c, vr, n, value));
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

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) { return DONE(model_take(c, state)); }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
  return DONE(model_restore(c, state, model_state_size()));
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
  (void)c;
  model_free_state(state);
  return fmi2OK;
}
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
  (void)c, (void)state;
  *size = model_state_size();
  return DONE(!*size);
}
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
  return DONE(model_write_state(c, state, bytes, size));
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
  return DONE(model_read_state(c, bytes, size, state));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference of[], size_t n_of,
                                        const fmi2ValueReference by[], size_t n_by, const fmi2Real along[],
                                        fmi2Real result[]) {
  (void)of, (void)n_of, (void)by, (void)n_by, (void)along, (void)result;
  return DONE(model_refuse(c, "this FMU has no directional derivatives"));
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
  return DONE(model_refuse(c, "no step is pending: steps are done when they return"));
}

/* no step is ever pending, so that there is no status to ask for */
#define STATUS(name, type)                                                                 \
  fmi2Status name(fmi2Component c, const fmi2StatusKind kind, type *value) {               \
    (void)c, (void)kind, (void)value;                                                      \
    return fmi2Discard;                                                                    \
  }
STATUS(fmi2GetStatus, fmi2Status)
STATUS(fmi2GetIntegerStatus, fmi2Integer)
STATUS(fmi2GetStringStatus, fmi2String)
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
  if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
  return DONE(model_get(c, 0, value));
}
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
  (void)c;
  if (kind != fmi2Terminated) return fmi2Discard;
  *value = fmi2False;
  return fmi2OK;
}
