#include "events.h"

#include <stdarg.h>
#include <stdio.h>

void events_add(Events *self, int64_t time_ns, const char *format, ...) {
    LoggedEvent *event = self->waiting + self->written++ % EVENTS_MAX;
    va_list values;
    event->time_ns = time_ns;
    va_start(values, format);
    vsnprintf(event->text, sizeof event->text, format, values);
    va_end(values);
}

bool events_copy(const Events *self, int64_t *read, LoggedEvent *out) {
    if (*read < self->written - EVENTS_MAX) {
        *read = self->written - EVENTS_MAX;
    }
    if (*read == self->written) {
        return false;
    }
    *out = self->waiting[(*read)++ % EVENTS_MAX];
    return true;
}
