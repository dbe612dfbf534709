/* Events as texts that wait for the log and for the ground station. */
#ifndef DMRAC_MAMBO_EVENTS_H
#define DMRAC_MAMBO_EVENTS_H

#include <stdbool.h>
#include <stdint.h>

#define EVENTS_MAX 16
#define EVENT_TEXT_BYTES 100

typedef struct {
    int64_t time_ns;
    char text[EVENT_TEXT_BYTES];
} LoggedEvent;

/* A ring; the oldest is lost if more wait. */
typedef struct {
    LoggedEvent waiting[EVENTS_MAX];
    int64_t written;
} Events;

void events_add(Events *self, int64_t time_ns, const char *format, ...) __attribute__((format(printf, 3, 4)));

/* The oldest event that a reader, who has read `*read` of them, has not seen; false if there is none. */
bool events_copy(const Events *self, int64_t *read, LoggedEvent *out);

#endif
