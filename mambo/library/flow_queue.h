/* Flow calls on their way from the firmware's camera thread to the 200 Hz call: one writer, one reader, no lock. */
#ifndef DMRAC_MAMBO_FLOW_QUEUE_H
#define DMRAC_MAMBO_FLOW_QUEUE_H

#include "readings.h"

typedef struct {
    FlowCall calls[FLOW_CALLS_MAX];
    volatile uint32_t written;
    volatile uint32_t taken;
    volatile uint32_t lost;
} FlowQueue;

/* By the camera thread. If the reader is too slow, the call is lost. */
void flow_queue_put(FlowQueue *self, const FlowCall *call);

/* By the 200 Hz call: all that wait, at most FLOW_CALLS_MAX; returns their number. */
int32_t flow_queue_take(FlowQueue *self, FlowCall *calls);

#endif
