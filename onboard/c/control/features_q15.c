#include "control/features_q15.h"

#include <stddef.h>
#include <string.h>

#include "control/q15_pairs.h"
#include "numerics/block.h"
#include "numerics/elementary.h"

#define INPUT_BITS 13
#define SUM_BITS 16
#define STEP_BITS 11 /* of a number with SUM_BITS, within one step of the table: 1/32 */
#define SIZE_MAX_Q 32766
#define SUM_MAX_Q 64800 /* of the sizes of a row's numbers: with 16-bit inputs no sum exceeds 32 bits */

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

/* Outputs of a layer, in pairs. */
static void evaluate_layer(const WholeNetwork *self, const Place *at, int32_t width, const int32_t *below,
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
        evaluate_layer(self, &at, width, below, l > 0 ? OUTPUT_BITS : INPUT_BITS, above);
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

static void round_inputs(const Features *self, const real *z, int32_t *pairs) {
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
    round_inputs(self, z, inputs);
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

/* --- the slope: J of a layer in whole numbers with a common unit --- */

/* J' [n, outputs] of a layer, in pairs; a number of it is value times `unit`. */
typedef struct {
    int32_t rows[INPUTS_MAX][PAIRS_MAX];
    real unit;
} WholeSlopes;

/* dz/dx of the inputs, zero where one is clipped: a number for each. */
static void slopes_of_inputs(const Features *self, const real *z, const int32_t *inputs, int32_t n, int32_t *values,
                             real *unit) {
    real largest = REAL(0.0);
    for (int32_t j = 0; j < n; j++) {
        largest = real_max(largest, self->inverse[inputs[j]]);
    }
    for (int32_t j = 0; j < n; j++) {
        bool moves = real_abs(z[inputs[j]]) < INPUT_LIMIT;
        values[j] = moves ? rounded(REAL(16384.0) * (self->inverse[inputs[j]] / largest)) : 0;
    }
    *unit = largest / REAL(16384.0);
}

/* Bring the sums [n, WIDTH_MAX] of a layer to 16 bits. */
static void fit(int32_t sums[INPUTS_MAX][WIDTH_MAX], int32_t n, int32_t width, real unit, WholeSlopes *out) {
    int32_t largest = 1, shift = 0;
    for (int32_t j = 0; j < n; j++) {
        for (int32_t i = 0; i < width; i++) {
            int32_t size = sums[j][i] < 0 ? -sums[j][i] : sums[j][i];
            largest = size > largest ? size : largest;
        }
    }
    for (; largest > 32766; largest >>= 1) {
        shift++;
    }
    for (; largest < 16384; largest <<= 1) {
        shift--;
    }
    for (int32_t j = 0; j < n; j++) {
        for (int32_t i = 0; i < width; i += 2) {
            int32_t high = i + 1 < width ? shifted(sums[j][i + 1], shift) : 0;
            out->rows[j][i / 2] = pair_of(shifted(sums[j][i], shift), high);
        }
    }
    out->unit = shift >= 0 ? unit * (real)((int32_t)1 << shift) : unit / (real)((int32_t)1 << -shift);
}

/* D W J of one layer, whose outputs are given: for each input the sum over the outputs below; the first layer has one number
 * for each input. */
static void slopes_of_layer(const WholeNetwork *self, const Place *at, int32_t width, const int32_t *outputs,
                            const int32_t *first, const int32_t *inputs, int32_t n, WholeSlopes *slopes) {
    int32_t sums[INPUTS_MAX][WIDTH_MAX], pairs = pairs_for(at->inputs);
    const int32_t *row = self->pairs + at->pair;
    const int8_t *bits = self->bits + at->row;
    int32_t fewest = fewest_bits(bits, width);
    for (int32_t i = 0; i < width; i++, row += pairs) {
        int32_t h = number_of(outputs, i), steepness = (1 << OUTPUT_BITS) - ((h * h) >> OUTPUT_BITS);
        int32_t shift = OUTPUT_BITS + bits[i] - fewest;
        for (int32_t j = 0; j < n; j++) {
            int32_t sum = first ? number_of(row, inputs[j]) * first[j] : dot_of_pairs(row, slopes->rows[j], pairs);
            sums[j][i] = (int32_t)(((int64_t)sum * steepness) >> shift);
        }
    }
    fit(sums, n, width, slopes->unit / (real)((int32_t)1 << fewest), slopes);
}

static void slopes_of_network(const Features *self, const real *z, const int32_t *inputs, int32_t n,
                              WholeSlopes *slopes) {
    const Network *network = &self->network;
    int32_t levels[2][PAIRS_MAX], rounded_z[PAIRS_MAX], first[INPUTS_MAX];
    Place at = {0, 0, 0, self->selection.count};
    const int32_t *below = rounded_z;
    round_inputs(self, z, rounded_z);
    slopes_of_inputs(self, z, inputs, n, first, &slopes->unit);
    for (int32_t l = 0; l < network->layers; l++) {
        int32_t width = network->width[l], *above = levels[l % 2];
        evaluate_layer(&self->whole, &at, width, below, l > 0 ? OUTPUT_BITS : INPUT_BITS, above);
        slopes_of_layer(&self->whole, &at, width, above, l == 0 ? first : NULL, inputs, n, slopes);
        at = (Place){0, at.row + width, at.pair + width * pairs_for(at.inputs), width};
        below = above;
    }
}

void q15_slope_real(const Features *self, const real *z, const int32_t *inputs, int32_t n, real *J) {
    WholeSlopes slopes;
    int32_t count = self->feature_count - 1;
    slopes_of_network(self, z, inputs, n, &slopes);
    for (int32_t i = 0; i < count; i++) {
        for (int32_t j = 0; j < n; j++) {
            J[i * n + j] = slopes.unit * (real)number_of(slopes.rows[j], i);
        }
    }
}

/* --- the slope of a map: theta'D_L W_L ... D_1 W_1, from the last layer down, three axes at once --- */

/* Of the three axes over the outputs of a layer, or over its inputs; a number of an axis is value times `unit`. */
typedef struct {
    int32_t values[3][2 * PAIRS_MAX];
    real unit[3];
} MapSlopes;

/* The axis times D of a layer, so that no sum of its products with the rows exceeds 32 bits. */
static void weigh(const WholeNetwork *self, const Place *at, int32_t width, const int32_t *outputs, int32_t *values,
                  real *unit) {
    const int8_t *bits = self->bits + at->row;
    int32_t fewest = fewest_bits(bits, width), largest = 1, shift = 0;
    int64_t sum = 1;
    for (int32_t i = 0; i < width; i++) {
        int32_t h = number_of(outputs, i), steepness = (1 << OUTPUT_BITS) - ((h * h) >> OUTPUT_BITS);
        values[i] = (int32_t)(((int64_t)values[i] * steepness) >> (OUTPUT_BITS + bits[i] - fewest));
        int32_t size = values[i] < 0 ? -values[i] : values[i];
        largest = size > largest ? size : largest;
        sum += size;
    }
    for (; (sum >> shift) > SUM_MAX_Q || (largest >> shift) > SIZE_MAX_Q; shift++) {
    }
    for (; shift <= 0 && (sum << (1 - shift)) <= SUM_MAX_Q && (largest << (1 - shift)) <= SIZE_MAX_Q; shift--) {
    }
    for (int32_t i = 0; i < width; i++) {
        values[i] = shifted(values[i], shift);
    }
    *unit *= (shift >= 0 ? (real)((int32_t)1 << shift) : REAL(1.0) / (real)((int32_t)1 << -shift)) /
             (real)((int32_t)1 << fewest);
}

/* d'W of the rows of a layer, of all axes. */
static void go_down(const int32_t *rows, int32_t width, int32_t inputs, MapSlopes *slopes) {
    int32_t pairs = pairs_for(inputs), first_two[WIDTH_MAX];
    int16_t third[WIDTH_MAX];
    for (int32_t i = 0; i < width; i++) {
        first_two[i] = pair_of(slopes->values[0][i], slopes->values[1][i]);
        third[i] = (int16_t)slopes->values[2][i];
    }
    for (int32_t p = 0; p < pairs; p++) {
        const int32_t *row = rows + p;
        int32_t sums[6] = {0, 0, 0, 0, 0, 0};
        for (int32_t i = 0; i < width; i++, row += pairs) {
            int32_t w = *row, two = first_two[i];
            int16_t one = third[i];
            sums[0] += low_of(two) * low_of(w);
            sums[1] += low_of(two) * high_of(w);
            sums[2] += high_of(two) * low_of(w);
            sums[3] += high_of(two) * high_of(w);
            sums[4] += one * low_of(w);
            sums[5] += one * high_of(w);
        }
        for (int axis = 0; axis < 3; axis++) {
            slopes->values[axis][2 * p] = sums[2 * axis];
            slopes->values[axis][2 * p + 1] = sums[2 * axis + 1];
        }
    }
}

void q15_map_slope(const Features *self, const real *theta, const real *z, const int32_t *inputs, int32_t n,
                   real *slope) {
    const Network *network = &self->network;
    int32_t levels[LAYERS_MAX][PAIRS_MAX], rounded_z[PAIRS_MAX], m = self->selection.count;
    MapSlopes slopes;
    Place at[LAYERS_MAX];
    round_inputs(self, z, rounded_z);
    for (int axis = 0; axis < 3; axis++) {
        slopes.unit[axis] = block_of(theta + axis, self->feature_count - 1, 3, slopes.values[axis]);
    }
    for (int32_t l = 0; l < network->layers; l++) {
        at[l] = place_of(network, m, l);
        evaluate_layer(&self->whole, at + l, network->width[l], l > 0 ? levels[l - 1] : rounded_z,
                       l > 0 ? OUTPUT_BITS : INPUT_BITS, levels[l]);
    }
    for (int32_t l = network->layers - 1; l >= 0; l--) {
        for (int axis = 0; axis < 3; axis++) {
            weigh(&self->whole, at + l, network->width[l], levels[l], slopes.values[axis], slopes.unit + axis);
        }
        go_down(self->whole.pairs + at[l].pair, network->width[l], at[l].inputs, &slopes);
    }
    for (int32_t j = 0; j < n; j++) {
        real of_input = real_abs(z[inputs[j]]) < INPUT_LIMIT ? self->inverse[inputs[j]] : REAL(0.0);
        for (int axis = 0; axis < 3; axis++) {
            slope[axis * n + j] = (real)slopes.values[axis][inputs[j]] * (slopes.unit[axis] * of_input);
        }
    }
}

#endif
