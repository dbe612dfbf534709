/* No adaptation: nu_ad = 0. The twin of onboard/control/laws/none.py. */
#ifndef DMRAC_NONE_H
#define DMRAC_NONE_H

#include "numerics/real.h"

void none_step(real nu_ad[3]);

#endif
