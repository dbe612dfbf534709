/* The bytes of a feature set: the twin of protocol/feature_codec.py, which explains them. The flight core only decodes. */
#ifndef DMRAC_FEATURE_CODEC_H
#define DMRAC_FEATURE_CODEC_H

#include <stddef.h>

#include "protocol/feature_set.h"

/* The feature set in `data`, with all its values checked. Returns REFUSAL_NONE, or why there is none: REFUSAL_UNDECODABLE,
 * REFUSAL_INPUTS (an unknown signal) or REFUSAL_NOT_FINITE; `out` has not changed then. Of a core built with a smaller
 * PARAMETERS_MAX, a network that does not fit is undecodable. */
Refusal decode_feature_set(const uint8_t *data, size_t size, FeatureSet *out);

#endif
