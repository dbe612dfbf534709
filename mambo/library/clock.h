/* The two clocks of the library. They are exported, so that the program that loads the library may replace them: the
 * stand-in for the firmware flies in virtual time. */
#ifndef DMRAC_MAMBO_CLOCK_H
#define DMRAC_MAMBO_CLOCK_H

#include "firmware.h"

/* Monotonic, ns. */
EXPORTED int64_t dmrac_clock_ns(void);
/* Since 1970, ns; wrong on a drone whose clock was not set. */
EXPORTED int64_t dmrac_wall_clock_ns(void);

#endif
