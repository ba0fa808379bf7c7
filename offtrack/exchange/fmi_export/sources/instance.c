/* What every instance needs: its memory, log messages, values one by one, states and the check of a step. */

#include "instance.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LONGEST_MESSAGE 1000
#define LONGEST_STEP 1e6 /* [s] */

int model_refuse(Model *model, const char *format, ...) {
  char message[LONGEST_MESSAGE];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(message, sizeof message, format, arguments);
  va_end(arguments);
  if (model->log) model->log(model, message);
  return 1;
}

static char *copied(const char *text) {
  size_t length = text ? strlen(text) + 1 : 1;
  char *copy = malloc(length);
  if (copy) memcpy(copy, text ? text : "", length);
  return copy;
}

Model *model_new(Model begin, const char *token) {
  Model *model = calloc(1, sizeof *model);
  if (!model) return NULL;
  *model = begin;
  model->data = calloc(1, model_data_size());
  model->name = copied(begin.name);
  model->resources = copied(begin.resources);
  if (!model->data || !model->name || !model->resources) {
    free(model->data);
    free(model->name);
    free(model->resources);
    free(model);
    return NULL;
  }
  model_reset(model);
  if (token && !strcmp(token, TOKEN)) return model;
  model_refuse(model, "the GUID or instantiation token is not that of this FMU, which is " TOKEN);
  model_free(model);
  return NULL;
}

void model_free(Model *model) {
  if (!model) return;
  model_release(model);
  free(model->name);
  free(model->resources);
  free(model->data);
  free(model);
}

/* a function of all values, by that of one */
#define ALL(name, value_type, one)                                                             \
  int name(Model *model, const unsigned *references, size_t n, value_type values) {            \
    for (size_t k = 0; k < n; k++)                                                             \
      if (one) return 1;                                                                       \
    return 0;                                                                                  \
  }
ALL(model_get_all, double *, model_get(model, references[k], values + k))
ALL(model_set_all, const double *, model_set(model, references[k], values[k]))
ALL(model_get_texts, const char **, model_get_text(model, references[k], values + k))
ALL(model_set_texts, const char *const *, model_set_text(model, references[k], values[k]))

int model_take(Model *model, void **state) {
  size_t size = model_state_size();
  if (!size)
    return model_refuse(model, "the state of this FMU cannot be taken or set: it is in another process");
  if (!*state) *state = malloc(size);
  if (!*state) return 1;
  memcpy(*state, model->data, size);
  return 0;
}

int model_write_state(Model *model, const void *state, void *bytes, size_t size) {
  if (!state || size < model_state_size())
    return model_refuse(model, "a state needs %lu bytes", (unsigned long)model_state_size());
  memcpy(bytes, state, model_state_size());
  return 0;
}

int model_read_state(Model *model, const void *bytes, size_t size, void **state) {
  if (size != model_state_size())
    return model_refuse(model, "%lu bytes are no state of this model, which has %lu", (unsigned long)size,
                        (unsigned long)model_state_size());
  if (model_take(model, state)) return 1;
  memcpy(*state, bytes, size);
  return 0;
}

void model_free_state(void **state) {
  free(*state);
  *state = NULL;
}

int model_check_step(Model *model, double now, double time, double step) {
  if (!(step > 0.0 && step <= LONGEST_STEP))
    return model_refuse(model, "communication step of %.9g s must be above 0, at most %g s", step, LONGEST_STEP);
  if (!(fabs(time - now) < 0.5 * fmin(TICK, step)))
    return model_refuse(model, "the step begins at %.9g s, but the model is at %.9g s", time, now);
  return 0;
}
