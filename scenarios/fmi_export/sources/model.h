/* A plant as a model for co-simulation, whatever the version of FMI. */

#ifndef OFFTRACK_MODEL_H
#define OFFTRACK_MODEL_H

#include <stddef.h>

#include "portable.h"

#include "plant.h" /* sizes, names and the token of this plant */

#define TICK 0.001 /* [s] */

/* All that changes: plain numbers without pointers, so that copies of it are states of the FMU. */
typedef struct {
  double parameters[N_PARAMETERS];
  double inputs[N_INPUTS];
  double outputs[N_OUTPUTS];
  double state[N_STATES];
  double numbers[N_NUMBERS]; /* derived from the parameters */
  double start_time;         /* [s] */
  long long ticks;           /* since the start */
  int initialised;           /* 1 behind the initialisation: parameters are fixed */
  int started;               /* 1: the state fits parameters and, before the first step, inputs */
  int current;               /* 1: the outputs fit state and inputs */
} Data;

typedef enum { INFORMATION, REFUSAL } Severity;

typedef struct Model {
  Data data;
  void (*log)(struct Model *model, Severity severity, const char *message);
  void *environment; /* of the importer */
  void *callback;
  void *more; /* memory of the FMI version's part */
  char *name;
} Model;

/* of the plant; they return 0, or 1 with a reason in ``message`` (200 characters) */
HIDDEN int plant_start(Data *data, char *message);
HIDDEN int plant_advance(Data *data, long ticks, char *message);
HIDDEN void plant_observe(Data *data);

/* of the model; they return 0, or 1 after a log message */
HIDDEN Model *model_new(const char *name);
HIDDEN void model_free(Model *model);
HIDDEN void model_reset(Model *model);
HIDDEN int model_begin(Model *model, double start_time);
HIDDEN int model_initialise(Model *model);
HIDDEN int model_get(Model *model, unsigned reference, double *value);
HIDDEN int model_set(Model *model, unsigned reference, double value);
HIDDEN int model_step(Model *model, double time, double step);
HIDDEN int model_restore(Model *model, const void *bytes, size_t size);
HIDDEN void model_refuse(Model *model, const char *format, ...);

#endif
