#include "control/features_q15.h"

#include <stddef.h>

#include "numerics/elementary.h"

#define INPUT_BITS 13
#define OUTPUT_BITS 15
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

/* x / 2^shift, rounded to the nearest; a negative shift multiplies. */
static int64_t shifted(int64_t x, int shift) {
    if (shift <= 0) {
        return x * ((int64_t)1 << -shift);
    }
    int64_t half = (int64_t)1 << (shift - 1);
    return x >= 0 ? (x + half) >> shift : -((half - x) >> shift);
}

int16_t tanh_q15(int64_t x) {
    int64_t size = x < 0 ? -x : x;
    int64_t place = size >> STEP_BITS;
    int32_t value = TANH[TANH_POINTS - 1];
    if (place < TANH_POINTS - 1) {
        int32_t rest = (int32_t)(size - (place << STEP_BITS));
        int32_t step = TANH[place + 1] - TANH[place];
        value = TANH[place] + ((step * rest + (1 << (STEP_BITS - 1))) >> STEP_BITS);
    }
    return (int16_t)(x < 0 ? -value : value);
}

/* Fractional bits with which every number of a row fits into 16 bits; -1 if none. */
static int bits_of(const real *row, int count) {
    real largest = REAL(0.0);
    for (int i = 0; i < count; i++) {
        largest = real_max(largest, real_abs(row[i]));
    }
    int bits = OUTPUT_BITS;
    for (real limit = REAL(0.999); bits >= 0 && !(largest < limit); limit *= REAL(2.0)) {
        bits--;
    }
    return bits;
}

bool q15_rows(const Network *network, int32_t inputs, int16_t *rows, int8_t *bits) {
    int at = 0, row = 0;
    for (int l = 0; l < network->layers; l++) {
        for (int i = 0; i < network->width[l]; i++, row++) {
            int row_bits = bits_of(network->parameters + at, inputs + 1);
            if (row_bits < 0) {
                return false;
            }
            bits[row] = (int8_t)row_bits;
            for (int j = 0; j <= inputs; j++, at++) {
                real scaled = network->parameters[at] * (real)((int32_t)1 << row_bits);
                rows[at] = (int16_t)real_floor(scaled + REAL(0.5));
            }
        }
        inputs = network->width[l];
    }
    return true;
}

bool features_q15_init(FeaturesQ15 *self, const Features *source) {
    const Network *network = &source->network;
    self->selection = source->selection;
    self->layers = network->layers;
    for (int i = 0; i < source->selection.count; i++) {
        self->inverse[i] = source->inverse[i];
    }
    for (int l = 0; l < network->layers; l++) {
        self->width[l] = network->width[l];
    }
    return q15_rows(network, source->selection.count, self->parameters, self->bits);
}

static int16_t rounded_input(real z) {
    return (int16_t)real_floor(z * (real)(1 << INPUT_BITS) + REAL(0.5));
}

/* Features.select, rounded */
void features_q15_select(const FeaturesQ15 *self, const real signals[SIGNAL_COUNT], int16_t *z) {
    for (int i = 0; i < self->selection.count; i++) {
        real scaled = (signals[self->selection.index[i]] - self->selection.offset[i]) * self->inverse[i];
        scaled = real_max(real_min(scaled, INPUT_LIMIT), -INPUT_LIMIT);
        z[i] = rounded_input(scaled);
    }
}

/* One layer: `above` [count], 15 fractional bits, of `below` [inputs], `below_bits` of them. */
static void layer(const int16_t *row, const int8_t *bits, int count, const int16_t *below, int inputs, int below_bits,
                  int16_t *above) {
    for (int i = 0; i < count; i++) {
        int64_t sum = (int64_t)row[inputs] * ((int64_t)1 << below_bits);
        for (int j = 0; j < inputs; j++) {
            sum += (int32_t)row[j] * below[j];
        }
        above[i] = tanh_q15(shifted(sum, bits[i] + below_bits - SUM_BITS));
        row += inputs + 1;
    }
}

static void evaluate(const int16_t *row, const int8_t *bits, int layers, const int32_t *width, int inputs,
                     const int16_t *z, int16_t *Phi) {
    int16_t levels[2][WIDTH_MAX];
    const int16_t *below = z;
    int below_bits = INPUT_BITS;
    for (int l = 0; l < layers; l++) {
        int16_t *above = l == layers - 1 ? Phi : levels[l % 2];
        layer(row, bits, width[l], below, inputs, below_bits, above);
        row += width[l] * (inputs + 1);
        bits += width[l];
        inputs = width[l];
        below_bits = OUTPUT_BITS;
        below = above;
    }
}

/* Features.evaluate */
void features_q15_evaluate(const FeaturesQ15 *self, const int16_t *z, int16_t *Phi) {
    evaluate(self->parameters, self->bits, self->layers, self->width, self->selection.count, z, Phi);
    Phi[self->width[self->layers - 1]] = TANH[TANH_POINTS - 1];
}

#ifdef DMRAC_Q15_FEATURES

void q15_evaluate_real(const Features *self, const real *z, real *Phi) {
    const Network *network = &self->network;
    int16_t rounded[INPUTS_MAX], out[WIDTH_MAX];
    int inputs = self->selection.count, count = network->width[network->layers - 1];
    for (int i = 0; i < inputs; i++) {
        rounded[i] = rounded_input(z[i]);
    }
    evaluate(self->rows, self->bits, network->layers, network->width, inputs, rounded, out);
    for (int i = 0; i < count; i++) {
        Phi[i] = (real)out[i] * (REAL(1.0) / (real)(1 << OUTPUT_BITS));
    }
    Phi[count] = REAL(1.0);
}

/* --- the slope: J of a layer in whole numbers with a common unit --- */

/* J [count, n] of a layer; a number of it is value times `unit`. */
typedef struct {
    int16_t values[WIDTH_MAX * INPUTS_MAX];
    real unit;
} WholeSlopes;

/* dz/dx of the inputs, zero where one is clipped. */
static void slopes_of_inputs(const Features *self, const real *z, const int32_t *inputs, int32_t n, WholeSlopes *out) {
    real largest = REAL(0.0);
    for (int32_t j = 0; j < n; j++) {
        largest = real_max(largest, self->inverse[inputs[j]]);
    }
    for (int32_t j = 0; j < n; j++) {
        bool moves = real_abs(z[inputs[j]]) < INPUT_LIMIT;
        real share = REAL(16384.0) * (self->inverse[inputs[j]] / largest);
        out->values[j] = (int16_t)(moves ? real_floor(share + REAL(0.5)) : REAL(0.0));
    }
    out->unit = largest / REAL(16384.0);
}

/* Bring the sums of a layer to 16 bits. */
static void fit(const int32_t *sums, int32_t count, real unit, WholeSlopes *out) {
    int32_t largest = 1;
    int shift = 0;
    for (int32_t i = 0; i < count; i++) {
        int32_t size = sums[i] < 0 ? -sums[i] : sums[i];
        largest = size > largest ? size : largest;
    }
    for (; largest > 32767; largest >>= 1) {
        shift++;
    }
    for (; largest < 16384; largest <<= 1) {
        shift--;
    }
    for (int32_t i = 0; i < count; i++) {
        out->values[i] = (int16_t)shifted(sums[i], shift);
    }
    out->unit = shift >= 0 ? unit * (real)((int32_t)1 << shift) : unit / (real)((int32_t)1 << -shift);
}

static int32_t narrowed(int64_t x) {
    return x > INT32_MAX ? INT32_MAX : x < -INT32_MAX ? -INT32_MAX : (int32_t)x;
}

/* D W J of one layer: for an output the sum over the inputs below; the first layer's inputs are those of the slope alone. */
static void slopes_of_layer(const int16_t *row, const int8_t *bits, int count, int inputs, const int16_t *outputs,
                            const int32_t *first_inputs, int32_t n, WholeSlopes *slopes) {
    int32_t sums[WIDTH_MAX * INPUTS_MAX];
    for (int i = 0; i < count; i++, row += inputs + 1) {
        int32_t steepness = (1 << OUTPUT_BITS) - (((int32_t)outputs[i] * outputs[i]) >> OUTPUT_BITS);
        for (int32_t j = 0; j < n; j++) {
            int64_t sum = 0;
            if (first_inputs) {
                sum = (int32_t)row[first_inputs[j]] * slopes->values[j];
            } else {
                for (int m = 0; m < inputs; m++) {
                    sum += (int32_t)row[m] * slopes->values[m * n + j];
                }
            }
            sums[i * n + j] = narrowed(shifted(shifted(sum, bits[i]) * steepness, OUTPUT_BITS));
        }
    }
    fit(sums, count * n, slopes->unit, slopes);
}

void q15_slope_real(const Features *self, const real *z, const int32_t *inputs, int32_t n, real *J) {
    const Network *network = &self->network;
    const int16_t *row = self->rows;
    const int8_t *bits = self->bits;
    int16_t levels[2][WIDTH_MAX];
    WholeSlopes slopes;
    int count = self->selection.count, below_bits = INPUT_BITS;
    for (int i = 0; i < count; i++) {
        levels[1][i] = rounded_input(z[i]);
    }
    slopes_of_inputs(self, z, inputs, n, &slopes);
    for (int l = 0; l < network->layers; l++) {
        int16_t *above = levels[l % 2];
        layer(row, bits, network->width[l], levels[1 - l % 2], count, below_bits, above);
        slopes_of_layer(row, bits, network->width[l], count, above, l == 0 ? inputs : NULL, n, &slopes);
        row += network->width[l] * (count + 1);
        bits += network->width[l];
        count = network->width[l];
        below_bits = OUTPUT_BITS;
    }
    for (int32_t i = 0; i < count * n; i++) {
        J[i] = slopes.unit * (real)slopes.values[i];
    }
}

#endif
