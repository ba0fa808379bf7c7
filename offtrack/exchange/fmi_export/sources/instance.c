/* What every instance needs: its memory, log messages and the check of a communication step. */

#include "instance.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LONGEST_MESSAGE 1000
#define ROUNDING 1e-6    /* by which a step may miss whole ticks [ticks] */
#define LONGEST_STEP 1e6 /* [s] */

void model_refuse(Model *model, const char *format, ...) {
  char message[LONGEST_MESSAGE];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(message, sizeof message, format, arguments);
  va_end(arguments);
  if (model->log) model->log(model, REFUSAL, message);
}

static char *copied(const char *text) {
  size_t length = text ? strlen(text) + 1 : 1;
  char *copy = malloc(length);
  if (copy) memcpy(copy, text ? text : "", length);
  return copy;
}

Model *model_new(const char *name, const char *resources) {
  Model *model = calloc(1, sizeof *model);
  if (!model) return NULL;
  model->data = calloc(1, model_data_size());
  model->name = copied(name);
  model->resources = copied(resources);
  if (!model->data || !model->name || !model->resources) {
    free(model->data);
    free(model->name);
    free(model->resources);
    free(model);
    return NULL;
  }
  model_reset(model);
  return model;
}

void model_free(Model *model) {
  if (!model) return;
  model_release(model);
  free(model->more);
  free(model->name);
  free(model->resources);
  free(model->data);
  free(model);
}

int model_check_step(Model *model, double now, double time, double step, long *ticks) {
  double whole = floor(step / TICK + 0.5);
  int is_whole = step > 0.0 && step <= LONGEST_STEP && whole >= 1.0;
  if (!is_whole || fabs(step / TICK - whole) > ROUNDING * (1.0 + whole)) {
    model_refuse(model, "communication step of %.9g s must be a whole number of ticks of 1 ms", step);
    return 1;
  }
  if (!(fabs(time - now) < 0.5 * TICK)) {
    model_refuse(model, "the step begins at %.9g s, but the model is at %.9g s", time, now);
    return 1;
  }
  *ticks = (long)whole;
  return 0;
}
