/* The number of this run, larger at each start (protocol/session.py), also where the wall clock starts in 1970. */
#ifndef DMRAC_MAMBO_SESSION_H
#define DMRAC_MAMBO_SESSION_H

#include <stdint.h>

/* The larger of the wall clock's number and the last one + 1, which the file at `path` holds as text; it is written
 * anew. dmrac mambo start writes the laptop's time there. */
uint64_t next_session(const char *path, int64_t wall_clock_ns);

#endif
