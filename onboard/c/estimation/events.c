#include "estimation/events.h"

#include <string.h>

/* Corrections.report */
EstimatorEvent *estimator_report(EstimatorEvents *self, int64_t time_ns, EstimatorEventKind kind, int32_t number) {
    int32_t index = self->count < ESTIMATOR_EVENTS_MAX ? self->count++ : ESTIMATOR_EVENTS_MAX;
    EstimatorEvent *event = self->events + index;
    memset(event, 0, sizeof *event);
    event->time_ns = time_ns;
    event->kind = kind;
    event->number = number;
    return event;
}
