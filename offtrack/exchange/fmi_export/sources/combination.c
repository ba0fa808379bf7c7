/* A combination: its equations on ground that is held during a communication step. */

#include <string.h>

#include "model.h"
#include "programs.h"

int plant_start(Data *data, char *message) {
  double numbers[START_NC + 1], u[START_NU + 1];
  (void)message;
  memcpy(u, data->parameters + FIRST_START, 4 * sizeof *u); /* x, y, psi, speed */
  memcpy(u + 4, data->inputs + FIRST_GROUND, (START_NU - 4) * sizeof *u);
  start_derive(data->parameters, numbers);
  start_run(1, 1, u, u, numbers, data->state); /* it has no state before: the first u is not read */
  step_derive(data->parameters, data->numbers);
  observe_derive(data->parameters, data->numbers + STEP_NC);
  return 0;
}

int plant_advance(Data *data, long steps, double length, char *message) {
  double after[N_STATES], u[STEP_NU];
  (void)message;
  memcpy(u, data->inputs, sizeof u - sizeof *u);
  u[STEP_NU - 1] = length;
  step_run(1, steps, data->state, u, data->numbers, after);
  memcpy(data->state, after, sizeof after);
  return 0;
}

void plant_observe(Data *data) {
  observe_run(1, 1, data->state, data->inputs, data->numbers + STEP_NC, data->outputs);
}

int plant_never_zero(unsigned input) {
  return input == GEAR || (input >= FIRST_FRICTION && input < FIRST_FRICTION + N_FRICTIONS);
}
