#include "control/features_q15.h"

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

bool features_q15_init(FeaturesQ15 *self, const Features *source) {
    const Network *network = &source->network;
    self->selection = source->selection;
    self->layers = network->layers;
    int at = 0, row = 0, inputs = source->selection.count;
    for (int i = 0; i < inputs; i++) {
        self->inverse[i] = source->inverse[i];
    }
    for (int l = 0; l < network->layers; l++) {
        self->width[l] = network->width[l];
        for (int i = 0; i < network->width[l]; i++, row++) {
            int bits = bits_of(network->parameters + at, inputs + 1);
            if (bits < 0) {
                return false;
            }
            self->bits[row] = (int8_t)bits;
            for (int j = 0; j <= inputs; j++, at++) {
                real scaled = network->parameters[at] * (real)((int32_t)1 << bits);
                self->parameters[at] = (int16_t)real_floor(scaled + REAL(0.5));
            }
        }
        inputs = network->width[l];
    }
    return true;
}

/* Features.select, rounded */
void features_q15_select(const FeaturesQ15 *self, const real signals[SIGNAL_COUNT], int16_t *z) {
    for (int i = 0; i < self->selection.count; i++) {
        real scaled = (signals[self->selection.index[i]] - self->selection.offset[i]) * self->inverse[i];
        scaled = real_max(real_min(scaled, INPUT_LIMIT), -INPUT_LIMIT);
        z[i] = (int16_t)real_floor(scaled * (real)(1 << INPUT_BITS) + REAL(0.5));
    }
}

/* Features.evaluate */
void features_q15_evaluate(const FeaturesQ15 *self, const int16_t *z, int16_t *Phi) {
    int16_t levels[2][WIDTH_MAX];
    const int16_t *row = self->parameters, *below = z;
    const int8_t *bits = self->bits;
    int inputs = self->selection.count, input_bits = INPUT_BITS;
    for (int l = 0; l < self->layers; l++) {
        int16_t *above = l == self->layers - 1 ? Phi : levels[l % 2];
        for (int i = 0; i < self->width[l]; i++, bits++) {
            int64_t sum = (int64_t)row[inputs] * ((int64_t)1 << input_bits);
            for (int j = 0; j < inputs; j++) {
                sum += (int32_t)row[j] * below[j];
            }
            above[i] = tanh_q15(shifted(sum, *bits + input_bits - SUM_BITS));
            row += inputs + 1;
        }
        inputs = self->width[l];
        input_bits = OUTPUT_BITS;
        below = above;
    }
    Phi[inputs] = TANH[TANH_POINTS - 1];
}
