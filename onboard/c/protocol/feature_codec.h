/* The bytes of a feature set: the twin of protocol/feature_codec.py, which explains them. The flight core only decodes. */
#ifndef DMRAC_FEATURE_CODEC_H
#define DMRAC_FEATURE_CODEC_H

#include <stddef.h>

#include "control/features.h"

/* The feature set in `data`, with all its values checked; it must be of that version, 0 to 2^32 - 1. Returns REFUSAL_NONE,
 * or why there is none: REFUSAL_UNDECODABLE, REFUSAL_INPUTS (an unknown signal) or REFUSAL_NOT_FINITE; `out` has not changed
 * then. In a core built with a smaller PARAMETERS_MAX, a network that does not fit is undecodable. */
Refusal decode_feature_set(const uint8_t *data, size_t size, int64_t version, FeatureSet *out);

#endif
