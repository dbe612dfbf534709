#include "image.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "protocol/blake2b.h"
#include "protocol/little_endian.h"
#include "ranges.h"

#define MAGIC "DMRM"
#define VERSION 1
#define PARTS 5
#define HEADER_BYTES (4 * (3 + PARTS))
#define DIGEST_BYTES_OF_IMAGE 32
/* What a packed record begins with: its word and the name of its layout. */
#define RECORD_HEADER_BYTES 12
#define OTHER_VERSION "the image was made for another version of this library: run dmrac mambo config again"

typedef struct {
    const uint8_t *bytes;
    size_t size;
} Part;

static bool refuse(ImageFault *fault, const char *format, ...) __attribute__((format(printf, 2, 3)));

static bool refuse(ImageFault *fault, const char *format, ...) {
    va_list values;
    va_start(values, format);
    vsnprintf(fault->text, sizeof fault->text, format, values);
    va_end(values);
    return false;
}

static uint32_t read_u32(const uint8_t *bytes) {
    return (uint32_t)bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 | (uint32_t)bytes[3] << 24;
}

static bool digest_is_right(const uint8_t *bytes, size_t size) {
    static const uint8_t person[BLAKE2B_PERSON_BYTES] = "dmrac image";
    const uint8_t *payload = bytes + HEADER_BYTES + DIGEST_BYTES_OF_IMAGE;
    uint8_t digest[DIGEST_BYTES_OF_IMAGE];
    Blake2b hash;
    blake2b_start(&hash, DIGEST_BYTES_OF_IMAGE, NULL, 0, person);
    blake2b_add(&hash, bytes, HEADER_BYTES);
    blake2b_add(&hash, payload, size - HEADER_BYTES - DIGEST_BYTES_OF_IMAGE);
    blake2b_finish(&hash, digest);
    return memcmp(digest, bytes + HEADER_BYTES, sizeof digest) == 0;
}

/* Header and digest are right: `parts` are then the parts of the image. */
static bool split(const uint8_t *bytes, size_t size, Part parts[PARTS], ImageFault *fault) {
    if (size < HEADER_BYTES + DIGEST_BYTES_OF_IMAGE || size > IMAGE_BYTES_MAX || memcmp(bytes, MAGIC, 4) != 0) {
        return refuse(fault, "not a configuration image: %lu bytes", (unsigned long)size);
    }
    if (read_u32(bytes + 4) != VERSION) {
        return refuse(fault, "image of version %lu, this library reads version %d", (unsigned long)read_u32(bytes + 4),
                      VERSION);
    }
    size_t sum = HEADER_BYTES + DIGEST_BYTES_OF_IMAGE;
    for (int i = 0; i < PARTS; i++) {
        parts[i] = (Part){bytes + sum, read_u32(bytes + 12 + 4 * i)};
        if (parts[i].size > size - sum) {
            return refuse(fault, "size: part %d of the image is longer than the file", i);
        }
        sum += parts[i].size;
    }
    if (sum != size || read_u32(bytes + 8) != size) {
        return refuse(fault, "size: the file has %lu bytes, its header says %lu", (unsigned long)size,
                      (unsigned long)read_u32(bytes + 8));
    }
    return digest_is_right(bytes, size) || refuse(fault, "digest: the image is damaged");
}

static bool is_in_range(const Part *part, size_t size, const Range *ranges, int32_t count, const RangeGuard *guards,
                        ImageFault *fault) {
    double value;
    if (part->size != size) {
        return refuse(fault, OTHER_VERSION);
    }
    const Range *wrong = range_fault(part->bytes + RECORD_HEADER_BYTES, ranges, count, guards, &value);
    if (wrong == NULL) {
        return true;
    }
    return refuse(fault, "%s is %g, allowed is %s %g to %s %g", wrong->name, value, wrong->low_open ? "above" : "from",
                  wrong->low, wrong->high_open ? "below" : "at most", wrong->high);
}

static bool copy_key(const Part *part, uint8_t key[IMAGE_KEY_MAX], int32_t *size, const char *name, ImageFault *fault) {
    bool allowed = part->size == 0 || (part->size >= KEY_MIN_BYTES && part->size <= IMAGE_KEY_MAX);
    if (!allowed) {
        return refuse(fault, "%s of %lu bytes, allowed are %d to %d", name, (unsigned long)part->size, KEY_MIN_BYTES,
                      IMAGE_KEY_MAX);
    }
    memcpy(key, part->bytes, part->size);
    *size = (int32_t)part->size;
    return true;
}

/* --- the features that a flight starts with --- */

/* Reads numbers of 8 bytes; `bad` once there were too few, or one was not allowed. */
typedef struct {
    const uint8_t *at;
    size_t left;
    bool bad;
} Numbers;

static uint64_t next_bits(Numbers *from) {
    if (from->left < 8) {
        from->bad = true;
        return 0;
    }
    uint64_t bits = read_u64(from->at);
    from->at += 8;
    from->left -= 8;
    return bits;
}

static real next_real(Numbers *from) {
    uint64_t bits = next_bits(from);
    double value;
    memcpy(&value, &bits, sizeof value);
    if (!(value > -3.0e38 && value < 3.0e38)) {
        from->bad = true;
        return REAL(0.0);
    }
    return (real)value;
}

static int32_t next_whole(Numbers *from, int32_t most) {
    uint64_t bits = next_bits(from);
    if (bits > (uint64_t)most) {
        from->bad = true;
        return 0;
    }
    return (int32_t)bits;
}

static void read_network(Numbers *from, int32_t inputs, ChannelFeatures *out) {
    Network *network = &out->network;
    int32_t width = inputs, parameters = 0;
    network->layers = next_whole(from, LAYERS_MAX);
    for (int32_t i = 0; i < network->layers; i++) {
        network->width[i] = next_whole(from, WIDTH_MAX);
        parameters += network->width[i] * (width + 1);
        width = network->width[i];
        from->bad = from->bad || width == 0;
    }
    if (from->bad || parameters > PARAMETERS_MAX) {
        from->bad = true;
        return;
    }
    for (int32_t i = 0; i < parameters; i++) {
        network->parameters[i] = next_real(from);
    }
    for (int32_t i = 0; network->layers > 0 && i < 3 * (width + 1); i++) {
        out->last_layer[i] = next_real(from);
    }
}

static void read_channel(Numbers *from, ChannelFeatures *out) {
    FeatureSelection *selection = &out->selection;
    memset(out, 0, sizeof *out);
    selection->count = next_whole(from, INPUTS_MAX);
    for (int32_t i = 0; i < selection->count; i++) {
        selection->index[i] = next_whole(from, SIGNAL_COUNT - 1);
        selection->offset[i] = next_real(from);
        selection->scale[i] = next_real(from);
        from->bad = from->bad || !(selection->scale[i] > REAL(0.0));
    }
    if (selection->count > 0) {
        read_network(from, selection->count, out);
    }
}

static bool read_features(const Part *part, ChannelFeatures start[2], ImageFault *fault) {
    Numbers from = {part->bytes, part->size, false};
    for (int i = 0; i < 2 && !from.bad; i++) {
        read_channel(&from, start + i);
    }
    if (from.bad || from.left > 0) {
        return refuse(fault, "features: not two channels of networks that this library can hold (%d parameters)",
                      PARAMETERS_MAX);
    }
    return true;
}

/* --- the whole image --- */

bool image_read(const uint8_t *bytes, size_t size, Image *out, ImageFault *fault) {
    Part parts[PARTS];
    fault->text[0] = '\0';
    if (!split(bytes, size, parts, fault)) {
        return false;
    }
    bool settings_fit = settings_decode(parts[0].bytes, parts[0].size, &out->settings);
    bool core_fits = config_decode(parts[1].bytes, parts[1].size, &out->core);
    return is_in_range(parts + 0, SETTINGS_IMAGE_BYTES, settings_ranges, settings_range_count, settings_guards,
                       fault) &&
           is_in_range(parts + 1, CONFIG_IMAGE_BYTES, core_ranges, core_range_count, core_guards, fault) &&
           ((settings_fit && core_fits) || refuse(fault, OTHER_VERSION)) &&
           read_features(parts + 2, out->start, fault) && copy_key(parts + 3, out->key, &out->key_size, "key", fault) &&
           copy_key(parts + 4, out->ground_key, &out->ground_key_size, "ground key", fault);
}
