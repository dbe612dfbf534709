#include "flow_queue.h"

#include "atomic.h"

void flow_queue_put(FlowQueue *self, const FlowCall *call) {
    if (self->written - self->taken == FLOW_CALLS_MAX) {
        self->lost++;
        return;
    }
    self->calls[self->written % FLOW_CALLS_MAX] = *call;
    atomic_barrier(); /* the call before its number */
    self->written++;
}

int32_t flow_queue_take(FlowQueue *self, FlowCall *calls) {
    uint32_t waiting = self->written - self->taken;
    atomic_barrier();
    for (uint32_t i = 0; i < waiting; i++) {
        calls[i] = self->calls[(self->taken + i) % FLOW_CALLS_MAX];
    }
    atomic_barrier(); /* read before the room is given back */
    self->taken += waiting;
    return (int32_t)waiting;
}
