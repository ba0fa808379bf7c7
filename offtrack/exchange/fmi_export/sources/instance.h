/* An instance of an FMU, whatever the version of FMI and whatever it simulates. */

#ifndef OFFTRACK_INSTANCE_H
#define OFFTRACK_INSTANCE_H

#include <stddef.h>

#include "portable.h"

#include "token.h" /* the token of this FMU */

#define TICK 0.001    /* [s] */
#define ROUNDING 1e-6 /* by which a step may miss whole ticks [ticks] */

typedef struct Data Data; /* all that changes while it runs; the kind of model defines it */

typedef struct Model {
  Data *data;
  void (*log)(struct Model *model, const char *message); /* of the FMI version: why a call was refused */
  void *environment;                                     /* of the importer */
  const void *callbacks;                                 /* of the importer, in FMI 2 */
  void (*callback)(void);                                /* of the importer, in FMI 3 */
  char *name;
  char *resources; /* folder or address of the FMU's resources */
} Model;

/* Of instance.c. A function that returns an int returns 0, or 1 after a log message. */
HIDDEN Model *model_new(Model begin, const char *token); /* copies the texts; NULL after a log message */
HIDDEN void model_free(Model *model);
HIDDEN int model_refuse(Model *model, const char *format, ...); /* 1 */
HIDDEN int model_check_step(Model *model, double now, double time, double step);
HIDDEN int model_get_all(Model *model, const unsigned *references, size_t n, double *values);
HIDDEN int model_set_all(Model *model, const unsigned *references, size_t n, const double *values);
HIDDEN int model_get_texts(Model *model, const unsigned *references, size_t n, const char **values);
HIDDEN int model_set_texts(Model *model, const unsigned *references, size_t n, const char *const *values);
HIDDEN int model_take(Model *model, void **state); /* a NULL is allocated, also below */
HIDDEN int model_write_state(Model *model, const void *state, void *bytes, size_t size);
HIDDEN int model_read_state(Model *model, const void *bytes, size_t size, void **state);
HIDDEN void model_free_state(void **state);

/* Of the kind of model. */
HIDDEN size_t model_data_size(void);
HIDDEN size_t model_state_size(void); /* of the data as a state that can be taken and set; 0: it cannot */
HIDDEN void model_reset(Model *model);
HIDDEN int model_begin(Model *model, double start_time);
HIDDEN int model_initialise(Model *model);
HIDDEN void model_terminate(Model *model);
HIDDEN void model_release(Model *model); /* ends and frees all that the data hold */
HIDDEN int model_get(Model *model, unsigned reference, double *value);
HIDDEN int model_set(Model *model, unsigned reference, double value);
HIDDEN int model_get_text(Model *model, unsigned reference, const char **value);
HIDDEN int model_set_text(Model *model, unsigned reference, const char *value);
HIDDEN int model_step(Model *model, double time, double step);
HIDDEN int model_restore(Model *model, const void *bytes, size_t size);

#endif
