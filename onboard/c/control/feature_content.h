/* CRC-32 and Adler-32 of what a version would fly: content_of in onboard/control/guard.py. */
#ifndef DMRAC_FEATURE_CONTENT_H
#define DMRAC_FEATURE_CONTENT_H

#include "control/features.h"

#define CONTENT_BYTES 8

/* The same for the same content under another number. */
void feature_content(const FeatureSet *features, uint8_t content[CONTENT_BYTES]);

#endif
