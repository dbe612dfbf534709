/* Slopes of the networks in whole numbers: q15_slope_real and q15_map_slope of features_q15.h. */
#include <stddef.h>

#include "control/features_q15.h"
#include "control/q15_pairs.h"
#include "numerics/block.h"
#include "numerics/elementary.h"

#ifdef DMRAC_Q15_FEATURES

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
    q15_round_inputs(self, z, rounded_z);
    slopes_of_inputs(self, z, inputs, n, first, &slopes->unit);
    for (int32_t l = 0; l < network->layers; l++) {
        int32_t width = network->width[l], *above = levels[l % 2];
        q15_evaluate_layer(&self->whole, &at, width, below, l > 0 ? OUTPUT_BITS : INPUT_BITS, above);
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
    q15_round_inputs(self, z, rounded_z);
    for (int axis = 0; axis < 3; axis++) {
        slopes.unit[axis] = block_of(theta + axis, self->feature_count - 1, 3, slopes.values[axis]);
    }
    for (int32_t l = 0; l < network->layers; l++) {
        at[l] = place_of(network, m, l);
        q15_evaluate_layer(&self->whole, at + l, network->width[l], l > 0 ? levels[l - 1] : rounded_z,
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

#else

typedef int slopes_in_real_numbers; /* ISO C forbids an empty file */

#endif
