/* A model that is computed by a Python process: values by reference, start, steps.

   A request is one byte, a size and as many bytes; so is an answer: '+' with values, '-' with the text of a failure. */

#include "instance.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "process.h"
#include "proxy.h" /* sizes and start values of this model */

#define MODULE "offtrack.exchange.fmi_proxy.proxy"
#define VARIABLE "OFFTRACK_PYTHON"
#define DEFAULT_PYTHON "python3"
#define CURE "; the parameter 'python' or the variable " VARIABLE " names the Python of an environment with offtrack"
#define LONGEST_REASON 800
#define LONGEST_ANSWER 1000000 /* of a text [bytes] */
#define LARGEST 1e12           /* of an input or output, in any SI unit */

/* value references: 0 is the time, then parameters, inputs, outputs, parameters that are texts, outputs that are texts */
#define FIRST_INPUT (1 + N_PARAMETERS)
#define FIRST_OUTPUT (FIRST_INPUT + N_INPUTS)
#define FIRST_TEXT (FIRST_OUTPUT + N_OUTPUTS)
#define FIRST_SAID (FIRST_TEXT + N_TEXTS)
#define END (FIRST_SAID + N_SAID)

/* places of the parameters that every proxy has */
#define START_TIMEOUT 0
#define STEP_TIMEOUT 1
#define PYTHON 0

static const double STARTS[] = {PARAMETER_STARTS};
static const double INPUT_STARTS_[] = {INPUT_STARTS};

struct Data {
  double parameters[N_PARAMETERS];
  double inputs[N_INPUTS];
  double outputs[N_OUTPUTS];
  char *texts[N_TEXTS];    /* NULL: empty */
  char *said[N_SAID + 1];  /* outputs that are texts, as they were last asked for; NULL: empty */
  Process *process;        /* NULL: not started, or ended */
  double start_time;       /* [s] */
  double elapsed;          /* since the start [s] */
  long long ticks;         /* of them, that the process has done */
  int initialised;         /* 1 behind the initialisation */
};

size_t model_data_size(void) { return sizeof(Data); }
size_t model_state_size(void) { return 0; }

/* the Python that computes, in the order in which it is looked for */
static const char *python_of(const Data *data) {
  const char *by_environment = getenv(VARIABLE);
  if (data->texts[PYTHON] && *data->texts[PYTHON]) return data->texts[PYTHON];
  return by_environment && *by_environment ? by_environment : DEFAULT_PYTHON;
}

static void ended(Data *data, int at_once) {
  process_end(data->process, at_once);
  data->process = NULL;
}

static void freed(char **texts, int n) {
  for (int k = 0; k < n; k++) {
    free(texts[k]);
    texts[k] = NULL;
  }
}

void model_reset(Model *model) {
  Data *data = model->data;
  ended(data, 0);
  freed(data->texts, N_TEXTS);
  freed(data->said, N_SAID);
  memset(data, 0, sizeof *data);
  memcpy(data->parameters, STARTS, sizeof data->parameters);
  memcpy(data->inputs, INPUT_STARTS_, sizeof data->inputs);
  memcpy(data->outputs, (const double[]){OUTPUT_STARTS}, sizeof data->outputs);
}

/* the values of the last step stay readable; the texts as well, until the instance is freed or reset */
void model_terminate(Model *model) { ended(model->data, 0); }

void model_release(Model *model) {
  ended(model->data, 0);
  freed(model->data->texts, N_TEXTS);
  freed(model->data->said, N_SAID);
}

int model_begin(Model *model, double start_time) {
  if (!isfinite(start_time))
    return model_refuse(model, "start time = %g s must be finite", start_time);
  model->data->start_time = start_time;
  return 0;
}

/* kills a process that failed, and says why */
static int failed(Model *model, const char *when, const char *reason, const char *cure) {
  Data *data = model->data;
  model_refuse(model, "%s: its Python process failed: %s%s", when, reason, cure);
  ended(data, 1);
  return 1;
}

/* Sends a request of two parts and receives the answer into ``values``, or as a text; 0, or 1 with a reason. */
static int ask(Process *process, char kind, const void *head, size_t n_head, const void *body, size_t n_body,
               double timeout, double *values, size_t n_values, char **text, char *reason) {
  double until = process_clock() + timeout;
  char begin[5], *content;
  uint32_t size = (uint32_t)(n_head + n_body);
  int bad = 1;
  begin[0] = kind;
  memcpy(begin + 1, &size, sizeof size);
  if (process_send(process, begin, sizeof begin, until, reason, LONGEST_REASON) ||
      process_send(process, head, n_head, until, reason, LONGEST_REASON) ||
      process_send(process, body, n_body, until, reason, LONGEST_REASON) ||
      process_receive(process, begin, sizeof begin, until, reason, LONGEST_REASON)) {
    if (process_clock() >= until) snprintf(reason, LONGEST_REASON, "it does not answer within %g s", timeout);
    return 1;
  }
  memcpy(&size, begin + 1, sizeof size);
  content = size <= LONGEST_ANSWER ? malloc((size_t)size + 1) : NULL;
  if (!content) {
    snprintf(reason, LONGEST_REASON, "it gave an answer of %lu bytes", (unsigned long)size);
    return 1;
  }
  if (!process_receive(process, content, size, until, reason, LONGEST_REASON)) {
    content[size] = 0;
    if (begin[0] != '+') {
      snprintf(reason, LONGEST_REASON, "%.700s", content);
    } else if (text) {
      free(*text);
      *text = content;
      return 0;
    } else if (size != n_values * sizeof *values) {
      snprintf(reason, LONGEST_REASON, "it gave %lu bytes, not %lu values", (unsigned long)size,
               (unsigned long)n_values);
    } else {
      if (size) memcpy(values, content, size);
      bad = 0;
    }
  }
  free(content);
  return bad;
}

/* the first request: the parameters, then every text with its size before it */
static int started(Model *model) {
  Data *data = model->data;
  char reason[LONGEST_REASON] = "", *texts;
  size_t size = 0, at = 0;
  int bad;
  for (int k = 0; k < N_TEXTS; k++) size += sizeof(uint32_t) + (data->texts[k] ? strlen(data->texts[k]) : 0);
  texts = malloc(size);
  if (!texts) return failed(model, "start", "no memory", "");
  for (int k = 0; k < N_TEXTS; k++) {
    uint32_t length = data->texts[k] ? (uint32_t)strlen(data->texts[k]) : 0;
    memcpy(texts + at, &length, sizeof length);
    if (length) memcpy(texts + at + sizeof length, data->texts[k], length);
    at += sizeof length + length;
  }
  bad = ask(data->process, 'i', data->parameters, sizeof data->parameters, texts, size,
            data->parameters[START_TIMEOUT], data->outputs, 0, NULL, reason);
  free(texts);
  return bad ? failed(model, "start", reason, strstr(reason, "No module") ? CURE : "") : 0;
}

int model_initialise(Model *model) {
  Data *data = model->data;
  char reason[LONGEST_REASON] = "";
  ended(data, 0);
  data->process = process_start(python_of(data), MODULE, model->resources, reason, sizeof reason);
  if (!data->process) return failed(model, "start", reason, CURE);
  if (started(model)) return 1;
  data->initialised = 1;
  return 0;
}

int model_get(Model *model, unsigned reference, double *value) {
  const Data *data = model->data;
  if (reference == 0) {
    *value = data->start_time + data->elapsed;
  } else if (reference < FIRST_INPUT) {
    *value = data->parameters[reference - 1];
  } else if (reference < FIRST_OUTPUT) {
    *value = data->inputs[reference - FIRST_INPUT];
  } else if (reference < FIRST_TEXT) {
    *value = data->outputs[reference - FIRST_OUTPUT];
  } else {
    return model_refuse(model, "value reference %u is no number", reference);
  }
  return 0;
}

int model_set(Model *model, unsigned reference, double value) {
  Data *data = model->data;
  if (reference == 0 || reference >= FIRST_OUTPUT)
    return model_refuse(model, "value reference %u is no number that can be set", reference);
  if (!(fabs(value) < LARGEST))
    return model_refuse(model, "value reference %u = %g must be finite and below %g", reference, value, LARGEST);
  if (reference >= FIRST_INPUT) {
    data->inputs[reference - FIRST_INPUT] = value;
  } else if (data->initialised) {
    return model_refuse(model, "value reference %u is a parameter, which is fixed after the initialisation",
                        reference);
  } else {
    data->parameters[reference - 1] = value;
  }
  return 0;
}

int model_get_text(Model *model, unsigned reference, const char **value) {
  Data *data = model->data;
  char reason[LONGEST_REASON] = "";
  char **place;
  unsigned char number;
  if (reference < FIRST_TEXT || reference >= END)
    return model_refuse(model, "value reference %u is no text", reference);
  place = reference < FIRST_SAID ? data->texts + (reference - FIRST_TEXT) : data->said + (reference - FIRST_SAID);
  if (reference >= FIRST_SAID && data->process) {
    number = (unsigned char)(reference - FIRST_SAID);
    if (ask(data->process, 't', &number, 1, NULL, 0, data->parameters[STEP_TIMEOUT], NULL, 0, place, reason))
      return failed(model, "text", reason, "");
  }
  *value = *place ? *place : "";
  return 0;
}

int model_set_text(Model *model, unsigned reference, const char *value) {
  Data *data = model->data;
  size_t length = value ? strlen(value) + 1 : 1;
  char *copy;
  if (reference < FIRST_TEXT || reference >= FIRST_SAID || data->initialised)
    return model_refuse(model, "value reference %u is no text that can be set%s", reference,
                        data->initialised ? " after the initialisation" : "");
  copy = malloc(length);
  if (!copy) return 1;
  memcpy(copy, value ? value : "", length);
  free(data->texts[reference - FIRST_TEXT]);
  data->texts[reference - FIRST_TEXT] = copy;
  return 0;
}

int model_step(Model *model, double time, double step) {
  Data *data = model->data;
  double now = data->start_time + data->elapsed, later = time + step - data->start_time;
  char reason[LONGEST_REASON] = "", when[40];
  int64_t head[2];
  if (!data->initialised || !data->process)
    return model_refuse(model, data->initialised ? "its Python process has ended: reset the instance"
                                                 : "a step needs an initialised model");
  if (model_check_step(model, now, time, step)) return 1;
  head[0] = data->ticks;
  head[1] = (long long)floor(later / TICK + ROUNDING * (1.0 + later)) - data->ticks; /* whole ones until then */
  data->elapsed = later;
  if (head[1] < 1) return 0;
  snprintf(when, sizeof when, "at %.9g s", now);
  if (ask(data->process, 's', head, sizeof head, data->inputs, sizeof data->inputs, data->parameters[STEP_TIMEOUT],
          data->outputs, N_OUTPUTS, NULL, reason))
    return failed(model, when, reason, "");
  data->ticks += head[1];
  return 0;
}

int model_restore(Model *model, const void *bytes, size_t size) {
  (void)bytes, (void)size;
  return model_refuse(model, "the state of this FMU cannot be set");
}
