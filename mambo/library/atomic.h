/* Order and exclusion between the firmware's threads, without the compiler's helper functions: a library that is built for ARMv5
 * with another compiler than gcc would miss them when the firmware loads it. The drone has one core. */
#ifndef DMRAC_MAMBO_ATOMIC_H
#define DMRAC_MAMBO_ATOMIC_H

#include <stdbool.h>
#include <stdint.h>

/* What is written before is written first, and what is read behind is read later. */
void atomic_barrier(void);

/* Whether the flag, which was 0, is the caller's now. */
bool atomic_take(volatile int32_t *flag);
void atomic_give_back(volatile int32_t *flag);

#endif
