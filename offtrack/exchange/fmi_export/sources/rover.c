/* A rover: its equations on ground that is held during a communication step. */

#include <math.h>
#include <string.h>

#include "model.h"
#include "programs.h"

#define SETTLING 2000    /* [ticks] */
#define BISECTIONS 60

/* input of the equations: demands, length of a step, ground */
static void inputs_of(const Data *data, double step, double *u) {
  memcpy(u, data->inputs, 2 * N_WHEELS * sizeof *u);
  u[2 * N_WHEELS] = step;
  memcpy(u + 2 * N_WHEELS + 1, data->inputs + 2 * N_WHEELS, (3 * N_WHEELS + 1) * sizeof *u);
}

#ifdef LIFT_NC
/* sinkage of a wheel that rolls without slip under a load; negative if the soil does not carry it */
static double settled_sinkage(const Data *data, double load) {
  double numbers[LIFT_NC + 1], low = 0.0, high = data->parameters[RADIUS], lift;
  lift_derive(data->parameters, numbers);
  lift_run(1, 1, &low, &high, numbers, &lift);
  if (lift < load) return -1.0;
  lift_run(1, 1, &low, &low, numbers, &lift);
  if (load <= lift) return 0.0;
  for (int k = 0; k < BISECTIONS; k++) {
    double middle = 0.5 * (low + high);
    lift_run(1, 1, &low, &middle, numbers, &lift);
    if (lift < load)
      low = middle;
    else
      high = middle;
  }
  return 0.5 * (low + high);
}
#endif

int plant_start(Data *data, char *message) {
  const double *start = data->parameters + FIRST_START; /* x, y, psi, speed */
  double u[STEP_NU + 1], after[N_STATES], spin = start[3] / data->parameters[RADIUS];
  (void)message;
  step_derive(data->parameters, data->numbers);
  observe_derive(data->parameters, data->numbers + STEP_NC);
  memset(data->state, 0, sizeof data->state);
  memcpy(data->state, start, 4 * sizeof *start);
  inputs_of(data, LONGEST_STEP * TICK, u);
  memset(u, 0, 2 * N_WHEELS * sizeof *u);
  for (int k = 0; k < N_WHEELS; k++) data->state[OMEGA + k] = u[k] = spin;
#ifdef LIFT_NC
  {
    double numbers[LOADS_NC + 1], loads[N_WHEELS], idle[STEP_NU + 1];
    memcpy(idle, u, sizeof idle);
    loads_derive(data->parameters, numbers);
    loads_run(1, 1, data->state, idle, numbers, loads);
    for (int k = 0; k < N_WHEELS; k++) {
      double sunk = settled_sinkage(data, loads[k]);
      if (sunk < 0.0) {
        strcpy(message, "the soil does not carry the rover: a wheel sinks to its axle");
        return 1;
      }
      data->state[SINKAGE + k] = (1.0 - data->inputs[FIRST_FIRM + k]) * sunk;
    }
  }
#endif
  step_run(1, SETTLING / LONGEST_STEP, data->state, u, data->numbers, after);
  memcpy(data->state, after, sizeof after);
  memcpy(data->state, start, 3 * sizeof *start);
  for (int k = 0; k < N_WHEELS; k++) data->state[TURN + k] = 0.0;
  return 0;
}

int plant_advance(Data *data, long steps, double length, char *message) {
  double u[STEP_NU + 1], after[N_STATES];
  (void)message;
  inputs_of(data, length, u);
  step_run(1, steps, data->state, u, data->numbers, after);
  memcpy(data->state, after, sizeof after);
  return 0;
}

void plant_observe(Data *data) {
  observe_run(1, 1, data->state, data->inputs, data->numbers + STEP_NC, data->outputs);
}

int plant_never_zero(unsigned input) {
  (void)input;
  return 0;
}
