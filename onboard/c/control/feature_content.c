#include "control/feature_content.h"

#include "protocol/blake2b.h"

static void hash_numbers(Blake2b *hash, const real *numbers, int32_t count) {
    blake2b_add(hash, (const uint8_t *)numbers, (size_t)count * sizeof *numbers);
}

/* content_of */
void feature_content(const FeatureSet *features, uint8_t content[CONTENT_BYTES]) {
    static const uint8_t nobody[BLAKE2B_PERSON_BYTES] = {0}, end[1] = {'|'};
    Blake2b hash;
    blake2b_start(&hash, CONTENT_BYTES, NULL, 0, nobody);
    for (int i = 0; i < 2; i++) {
        const ChannelFeatures *channel = features->channels + i;
        if (features->covers[i]) {
            int32_t inputs = channel->selection.count, parameters = 0;
            hash_numbers(&hash, channel->selection.offset, inputs);
            hash_numbers(&hash, channel->selection.scale, inputs);
            for (int32_t l = 0; l < channel->network.layers; l++) {
                parameters += channel->network.width[l] * (inputs + 1);
                inputs = channel->network.width[l];
            }
            hash_numbers(&hash, channel->network.parameters, parameters);
            hash_numbers(&hash, channel->last_layer, 3 * (inputs + 1));
        }
        blake2b_add(&hash, end, sizeof end);
    }
    blake2b_finish(&hash, content);
}
