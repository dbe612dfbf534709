#include "control/feature_content.h"

#include "numerics/checksum.h"

typedef struct {
    uint32_t crc;
    uint32_t adler;
} Checksums;

static void add_bytes(Checksums *sums, const uint8_t *bytes, size_t size) {
    sums->crc = crc32_of(bytes, size, sums->crc);
    sums->adler = adler32_of(bytes, size, sums->adler);
}

static void add_numbers(Checksums *sums, const real *numbers, int32_t count) {
    add_bytes(sums, (const uint8_t *)numbers, (size_t)count * sizeof *numbers);
}

/* content_of */
void feature_content(const FeatureSet *features, uint8_t content[CONTENT_BYTES]) {
    static const uint8_t end[1] = {'|'};
    Checksums sums = {0, 1};
    for (int i = 0; i < 2; i++) {
        const ChannelFeatures *channel = features->channels + i;
        if (features->covers[i]) {
            int32_t inputs = channel->selection.count, parameters = 0;
            add_numbers(&sums, channel->selection.offset, inputs);
            add_numbers(&sums, channel->selection.scale, inputs);
            for (int32_t l = 0; l < channel->network.layers; l++) {
                parameters += channel->network.width[l] * (inputs + 1);
                inputs = channel->network.width[l];
            }
            add_numbers(&sums, channel->network.parameters, parameters);
            add_numbers(&sums, channel->last_layer, 3 * (inputs + 1));
        }
        add_bytes(&sums, end, sizeof end);
    }
    for (int i = 0; i < 4; i++) {
        content[i] = (uint8_t)(sums.crc >> 8 * i & 255);
        content[4 + i] = (uint8_t)(sums.adler >> 8 * i & 255);
    }
}
