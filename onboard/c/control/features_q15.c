#include "control/features_q15.h"

#include <stddef.h>
#include <string.h>

#include "control/q15_pairs.h"
#include "numerics/block.h"
#include "numerics/elementary.h"

#define SUM_BITS 16
#define STEP_BITS 11 /* of a number with SUM_BITS, within one step of the table: 1/32 */

/* tanh(i / 32) 2^15, rounded, at most 32767. */
static const int16_t TANH[TANH_POINTS] = {
    0,     1024,  2045,  3063,  4075,  5079,  6073,  7056,  8025,  8980,  9919,  10840, 11743, 12625, 13486, 14326,
    15143, 15936, 16706, 17452, 18173, 18870, 19542, 20189, 20813, 21411, 21986, 22538, 23066, 23571, 24054, 24516,
    24956, 25376, 25776, 26157, 26519, 26864, 27191, 27502, 27797, 28076, 28341, 28592, 28830, 29055, 29268, 29470,
    29660, 29840, 30010, 30170, 30322, 30465, 30600, 30727, 30847, 30960, 31067, 31167, 31262, 31351, 31435, 31515,
    31589, 31659, 31726, 31788, 31846, 31901, 31953, 32002, 32048, 32091, 32132, 32170, 32206, 32240, 32271, 32301,
    32329, 32356, 32381, 32404, 32426, 32447, 32466, 32484, 32501, 32517, 32532, 32547, 32560, 32573, 32584, 32596,
    32606, 32616, 32625, 32634, 32642, 32649, 32657, 32663, 32670, 32676, 32681, 32686, 32691, 32696, 32700, 32704,
    32708, 32712, 32715, 32718, 32721, 32724, 32727, 32729, 32732, 32734, 32736, 32738, 32740, 32741, 32743, 32745,
    32746, 32747, 32749, 32750, 32751, 32752, 32753, 32754, 32755, 32755, 32756, 32757, 32758, 32758, 32759, 32759,
    32760, 32760, 32761, 32761, 32762, 32762, 32762, 32763, 32763, 32763, 32764, 32764, 32764, 32764, 32765, 32765,
    32765, 32765, 32765, 32766, 32766, 32766, 32766, 32766, 32766, 32766, 32766, 32767, 32767, 32767, 32767, 32767,
    32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767,
    32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767,
    32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767,
    32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767,
    32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767, 32767,
    32767};

int16_t tanh_q15(int32_t x) {
    int32_t size = x < 0 ? -x : x, place = size >> STEP_BITS, value = TANH[TANH_POINTS - 1];
    if (place < TANH_POINTS - 1) {
        int32_t rest = size - (place << STEP_BITS), step = TANH[place + 1] - TANH[place];
        value = TANH[place] + ((step * rest + (1 << (STEP_BITS - 1))) >> STEP_BITS);
    }
    return (int16_t)(x < 0 ? -value : value);
}

/* --- a network, rounded --- */

/* Fractional bits with which every number of a row fits into 16 bits, and every sum into 32; -1 if none. */
static int32_t bits_of(const real *row, int32_t count) {
    int64_t largest = 0, sum = 0;
    for (int32_t i = 0; i < count; i++) {
        int64_t whole = nearest_whole(row[i], OUTPUT_BITS), size = whole < 0 ? -whole : whole;
        largest = size > largest ? size : largest;
        sum += size;
    }
    for (int32_t bits = OUTPUT_BITS; bits >= 0; bits--, largest >>= 1, sum >>= 1) {
        if (largest < SIZE_MAX_Q && sum < SUM_MAX_Q) {
            return bits;
        }
    }
    return -1;
}

bool whole_take_layer(WholeNetwork *self, const Network *network, int32_t inputs, int32_t layer) {
    Place at = place_of(network, inputs, layer);
    int32_t below_bits = layer > 0 ? OUTPUT_BITS : INPUT_BITS, *pair = self->pairs + at.pair;
    const real *row = network->parameters + at.parameters;
    for (int32_t i = 0; i < network->width[layer]; i++, row += at.inputs + 1) {
        int32_t bits = bits_of(row, at.inputs + 1);
        if (bits < 0) {
            return false;
        }
        self->bits[at.row + i] = (int8_t)bits;
        self->biases[at.row + i] = nearest_whole(row[at.inputs], bits) * ((int32_t)1 << below_bits);
        for (int32_t j = 0; j < at.inputs; j += 2) {
            int32_t high = j + 1 < at.inputs ? nearest_whole(row[j + 1], bits) : 0;
            *pair++ = pair_of(nearest_whole(row[j], bits), high);
        }
    }
    return true;
}

/* --- features --- */

/* A scaled input, clipped. */
static int32_t rounded_input(real z) {
    const int32_t limit = (int32_t)(INPUT_LIMIT * (real)(1 << INPUT_BITS));
    int32_t whole = nearest_whole(z, INPUT_BITS);
    return whole > limit ? limit : whole < -limit ? -limit : whole;
}

/* The output of one row of a layer, of `below` with `below_bits` fractional bits. */
static int32_t output_of(const int32_t *row, int32_t bias, int32_t bits, const int32_t *below, int32_t pairs,
                         int32_t below_bits) {
    return tanh_q15(shifted(bias + dot_of_pairs(row, below, pairs), bits + below_bits - SUM_BITS));
}

void q15_evaluate_layer(const WholeNetwork *self, const Place *at, int32_t width, const int32_t *below,
                        int32_t below_bits, int32_t *above) {
    int32_t pairs = pairs_for(at->inputs);
    const int32_t *row = self->pairs + at->pair, *bias = self->biases + at->row;
    const int8_t *bits = self->bits + at->row;
    for (int32_t i = 0; i < width; i += 2, row += 2 * pairs) {
        int32_t low = output_of(row, bias[i], bits[i], below, pairs, below_bits), high = 0;
        if (i + 1 < width) {
            high = output_of(row + pairs, bias[i + 1], bits[i + 1], below, pairs, below_bits);
        }
        *above++ = pair_of(low, high);
    }
}

/* Outputs of all layers of `network` at inputs z, in pairs; returns those of the last one. */
static const int32_t *evaluate_all(const WholeNetwork *self, const Network *network, int32_t inputs, const int32_t *z,
                                   int32_t levels[2][PAIRS_MAX]) {
    Place at = {0, 0, 0, inputs};
    const int32_t *below = z;
    for (int32_t l = 0; l < network->layers; l++) {
        int32_t width = network->width[l], *above = levels[l % 2];
        q15_evaluate_layer(self, &at, width, below, l > 0 ? OUTPUT_BITS : INPUT_BITS, above);
        at = (Place){0, at.row + width, at.pair + width * pairs_for(at.inputs), width};
        below = above;
    }
    return below;
}

bool features_q15_init(FeaturesQ15 *self, const Features *source) {
    self->selection = source->selection;
    self->network = source->network;
    memcpy(self->inverse, source->inverse, sizeof self->inverse);
    for (int32_t l = 0; l < source->network.layers; l++) {
        if (!whole_take_layer(&self->whole, &source->network, source->selection.count, l)) {
            return false;
        }
    }
    return true;
}

/* Features.select, rounded */
void features_q15_select(const FeaturesQ15 *self, const real signals[SIGNAL_COUNT], int16_t *z) {
    for (int i = 0; i < self->selection.count; i++) {
        z[i] =
            (int16_t)rounded_input((signals[self->selection.index[i]] - self->selection.offset[i]) * self->inverse[i]);
    }
}

/* Features.evaluate */
void features_q15_evaluate(const FeaturesQ15 *self, const int16_t *z, int16_t *Phi) {
    int32_t inputs[PAIRS_MAX], levels[2][PAIRS_MAX], m = self->selection.count;
    int32_t count = self->network.width[self->network.layers - 1];
    for (int32_t i = 0; i < m; i += 2) {
        inputs[i / 2] = pair_of(z[i], i + 1 < m ? z[i + 1] : 0);
    }
    const int32_t *out = evaluate_all(&self->whole, &self->network, m, inputs, levels);
    for (int32_t i = 0; i < count; i++) {
        Phi[i] = (int16_t)number_of(out, i);
    }
    Phi[count] = TANH[TANH_POINTS - 1];
}

#ifdef DMRAC_Q15_FEATURES

void q15_round_inputs(const Features *self, const real *z, int32_t *pairs) {
    int32_t m = self->selection.count;
    for (int32_t i = 0; i < m; i += 2) {
        pairs[i / 2] = pair_of(rounded_input(z[i]), i + 1 < m ? rounded_input(z[i + 1]) : 0);
    }
}

/* Phi of the outputs of the last layer, in pairs. */
static void take_features(const Features *self, const int32_t *out, real *Phi) {
    int32_t count = self->feature_count - 1;
    for (int32_t i = 0; i < count; i++) {
        Phi[i] = (real)number_of(out, i) * (REAL(1.0) / (real)(1 << OUTPUT_BITS));
    }
    Phi[count] = REAL(1.0);
}

void q15_evaluate_real(const Features *self, const real *z, real *Phi) {
    int32_t inputs[PAIRS_MAX], levels[2][PAIRS_MAX];
    q15_round_inputs(self, z, inputs);
    take_features(self, evaluate_all(&self->whole, &self->network, self->selection.count, inputs, levels), Phi);
}

/* Features.select of one input, rounded. */
static int32_t input_at(const Features *self, const real *signals, int32_t i) {
    return rounded_input((signals[self->selection.index[i]] - self->selection.offset[i]) * self->inverse[i]);
}

static void inputs_at(const Features *self, const real *signals, int32_t *pairs) {
    int32_t m = self->selection.count;
    for (int32_t i = 0; i < m; i += 2) {
        pairs[i / 2] = pair_of(input_at(self, signals, i), i + 1 < m ? input_at(self, signals, i + 1) : 0);
    }
}

/* evaluate_layer of three states at once: each pair of the network is loaded once. */
static void evaluate_layer_of_three(const WholeNetwork *self, const Place *at, int32_t width,
                                    int32_t below[3][PAIRS_MAX], int32_t below_bits, int32_t above[3][PAIRS_MAX]) {
    int32_t pairs = pairs_for(at->inputs), before[3] = {0, 0, 0};
    const int32_t *row = self->pairs + at->pair;
    for (int32_t i = 0; i < width; i++, row += pairs) {
        int32_t sums[3], shift = self->bits[at->row + i] + below_bits - SUM_BITS, bias = self->biases[at->row + i];
        three_dots_of_pairs(row, below[0], PAIRS_MAX, pairs, sums);
        for (int state = 0; state < 3; state++) {
            int32_t one = tanh_q15(shifted(bias + sums[state], shift));
            above[state][i / 2] = i % 2 == 0 ? pair_of(one, 0) : pair_of(before[state], one);
            before[state] = one;
        }
    }
}

static void three_features_at(const Features *self, const real *signals, real *Phi, int32_t stride) {
    const Network *network = &self->network;
    int32_t levels[2][3][PAIRS_MAX], in_use = 0;
    Place at = {0, 0, 0, self->selection.count};
    for (int state = 0; state < 3; state++) {
        inputs_at(self, signals + state * SIGNAL_COUNT, levels[0][state]);
    }
    for (int32_t l = 0; l < network->layers; l++, in_use = 1 - in_use) {
        int32_t width = network->width[l];
        evaluate_layer_of_three(&self->whole, &at, width, levels[in_use], l > 0 ? OUTPUT_BITS : INPUT_BITS,
                                levels[1 - in_use]);
        at = (Place){0, at.row + width, at.pair + width * pairs_for(at.inputs), width};
    }
    for (int state = 0; state < 3; state++) {
        take_features(self, levels[in_use][state], Phi + state * stride);
    }
}

void q15_features_at(const Features *self, const real *signals, int32_t n, real *Phi, int32_t stride) {
    int32_t inputs[PAIRS_MAX], levels[2][PAIRS_MAX], m = self->selection.count, i = 0;
    for (; i + 3 <= n; i += 3) {
        three_features_at(self, signals + i * SIGNAL_COUNT, Phi + i * stride, stride);
    }
    for (; i < n; i++) {
        inputs_at(self, signals + i * SIGNAL_COUNT, inputs);
        take_features(self, evaluate_all(&self->whole, &self->network, m, inputs, levels), Phi + i * stride);
    }
}

#endif
