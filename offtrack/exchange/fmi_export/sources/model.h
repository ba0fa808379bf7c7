/* A plant: its data, and the functions of the kind of plant. */

#ifndef OFFTRACK_MODEL_H
#define OFFTRACK_MODEL_H

#include "instance.h"

#include "plant.h" /* sizes and names of this plant */

/* All that changes: plain numbers without pointers, so that copies of it are states of the FMU. */
struct Data {
  double parameters[N_PARAMETERS];
  double inputs[N_INPUTS];
  double outputs[N_OUTPUTS];
  double state[N_STATES];
  double numbers[N_NUMBERS]; /* derived from the parameters */
  double time;               /* [s] */
  int initialised;           /* 1 behind the initialisation: parameters are fixed */
  int started;               /* 1: the state fits parameters and, before the first step, inputs */
  int current;               /* 1: the outputs fit state and inputs */
};

/* of the plant; they return 0, or 1 with a reason in ``message`` (200 characters) */
HIDDEN int plant_start(Data *data, char *message);
HIDDEN int plant_advance(Data *data, long steps, double length, char *message); /* of each step [s] */
HIDDEN void plant_observe(Data *data);

/* true for an input that is never 0, a gear or a friction: importers that begin with 0 have no value for it yet */
HIDDEN int plant_never_zero(unsigned input);

#endif
