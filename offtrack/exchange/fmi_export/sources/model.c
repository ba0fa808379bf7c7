/* The model: values by reference, its start, and equal steps that make up a communication step. */

#include "model.h"
#include "programs.h"

#include <math.h>
#include <string.h>

#define LARGEST 1e12      /* of a state, in any SI unit */

/* value references: 0 is the time, then parameters, inputs and outputs */
#define FIRST_INPUT (1 + N_PARAMETERS)
#define FIRST_OUTPUT (FIRST_INPUT + N_INPUTS)
#define END (FIRST_OUTPUT + N_OUTPUTS)

static const double STARTS[] = {PARAMETER_STARTS};
static const double INPUT_STARTS_[] = {INPUT_STARTS};
static const char *const INPUT_NAMES_[] = {INPUT_NAMES};

size_t model_data_size(void) { return sizeof(Data); }
size_t model_state_size(void) { return sizeof(Data); }

void model_reset(Model *model) {
  Data *data = model->data;
  memset(data, 0, sizeof *data);
  memcpy(data->parameters, STARTS, sizeof data->parameters);
  memcpy(data->inputs, INPUT_STARTS_, sizeof data->inputs);
}

void model_terminate(Model *model) { (void)model; }
void model_release(Model *model) { (void)model; }

static int is_sane(const double *values, int n) {
  for (int k = 0; k < n; k++)
    if (!(fabs(values[k]) < LARGEST)) return 0;
  return 1;
}

/* the start's state, as long as the initialisation lasts */
static int ensure_started(Model *model) {
  Data *data = model->data;
  char message[200] = "";
  if (data->started) return 0;
  if (plant_start(data, message))
    return model_refuse(model, "the start failed: %s", message);
  if (!is_sane(data->state, N_STATES))
    return model_refuse(model, "the start failed: these parameters give a state that is not finite");
  data->started = 1;
  data->current = 0;
  return 0;
}

int model_begin(Model *model, double start_time) {
  if (!isfinite(start_time))
    return model_refuse(model, "start time = %g s must be finite", start_time);
  model->data->time = start_time;
  return 0;
}

int model_initialise(Model *model) {
  if (ensure_started(model)) return 1;
  model->data->initialised = 1;
  return 0;
}

int model_get(Model *model, unsigned reference, double *value) {
  Data *data = model->data;
  if (reference == 0) {
    *value = data->time;
  } else if (reference < FIRST_INPUT) {
    *value = data->parameters[reference - 1];
  } else if (reference < FIRST_OUTPUT) {
    *value = data->inputs[reference - FIRST_INPUT];
  } else if (reference < END) {
    if (ensure_started(model)) return 1;
    if (!data->current) plant_observe(data);
    data->current = 1;
    *value = data->outputs[reference - FIRST_OUTPUT];
  } else {
    return model_refuse(model, "value reference %u is not known", reference);
  }
  return 0;
}

int model_set(Model *model, unsigned reference, double value) {
  Data *data = model->data;
  if (reference == 0 || reference >= FIRST_OUTPUT)
    return model_refuse(model, "value reference %u is no parameter and no input", reference);
  if (!isfinite(value))
    return model_refuse(model, "value reference %u = %g must be finite", reference, value);
  if (reference < FIRST_INPUT) {
    if (data->initialised)
      return model_refuse(model, "value reference %u is a parameter, which is fixed after the initialisation",
                          reference);
    data->parameters[reference - 1] = value;
  } else {
    unsigned input = reference - FIRST_INPUT;
    data->inputs[input] = value == 0.0 && plant_never_zero(input) ? INPUT_STARTS_[input] : value;
  }
  if (!data->initialised) data->started = 0;
  data->current = 0;
  return 0;
}

/* the gear is a sign; anything between would drive with a share of the torque */
static int check_inputs(Model *model) {
#ifdef GEAR
  double gear = model->data->inputs[GEAR];
  if (gear != 1.0 && gear != -1.0)
    return model_refuse(model, "%s = %g must be 1 (forward) or -1 (backward)", INPUT_NAMES_[GEAR], gear);
#else
  (void)model;
  (void)INPUT_NAMES_;
#endif
  return 0;
}

int model_step(Model *model, double time, double step) {
  Data *data = model->data;
  Data before;
  double ticks = step / TICK;
  long steps = (long)ceil((ticks - ROUNDING) / LONGEST_STEP);
  char message[200] = "";
  if (!data->initialised)
    return model_refuse(model, "a step needs an initialised model");
  if (model_check_step(model, data->time, time, step) || check_inputs(model)) return 1;
  before = *data;
  if (steps < 1) steps = 1;
  if (plant_advance(data, steps, step / (double)steps, message) || !is_sane(data->state, N_STATES)) {
    *data = before;
    return model_refuse(model, "the state diverged in the step from %.9g s%s%s", time, *message ? ": " : "", message);
  }
  data->time = time + step;
  data->current = 0;
  return 0;
}

int model_get_text(Model *model, unsigned reference, const char **value) {
  (void)value;
  return model_refuse(model, "value reference %u is no text", reference);
}

int model_set_text(Model *model, unsigned reference, const char *value) {
  const char *unused = value;
  return model_get_text(model, reference, &unused);
}

int model_restore(Model *model, const void *bytes, size_t size) {
  if (!bytes || size != sizeof(Data))
    return model_refuse(model, "%lu bytes are no state of this model, which has %lu", (unsigned long)size,
                        (unsigned long)sizeof(Data));
  memcpy(model->data, bytes, size);
  return 0;
}
