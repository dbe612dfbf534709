#include "control/laws/none.h"

#include "protocol/geometry.h"

/* NoAugmentation.step */
void none_step(real nu_ad[3]) {
    vector_zero(nu_ad);
}
