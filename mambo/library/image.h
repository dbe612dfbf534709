/* The configuration image that `dmrac mambo config` makes: read, checked, and refused by name. mambo/image.py describes
 * it. */
#ifndef DMRAC_IMAGE_H
#define DMRAC_IMAGE_H

#include "control/features.h"
#include "generated/config.h"
#include "generated/settings.h"

#define IMAGE_BYTES_MAX (256 * 1024)
#define IMAGE_KEY_MAX 64

/* Why an image is refused, as a text for the log. */
typedef struct {
    char text[160];
} ImageFault;

typedef struct {
    LibraryConfig settings;
    CoreConfig core;
    ChannelFeatures start[2]; /* of both channels */
    uint8_t key[IMAGE_KEY_MAX];
    int32_t key_size; /* 0: none */
    uint8_t ground_key[IMAGE_KEY_MAX];
    int32_t ground_key_size; /* 0: none */
} Image;

/* False if the image is damaged, of another version, or has a number out of its range; `fault` names it, and `out` must
 * not be used then. */
bool image_read(const uint8_t *bytes, size_t size, Image *out, ImageFault *fault);

#endif
