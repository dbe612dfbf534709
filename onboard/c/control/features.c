#include "control/features.h"

#include <string.h>

#include "control/features_q15.h"
#include "numerics/elementary.h"
#include "numerics/small_matrix.h"

/* ChannelFeatures.feature_count */
int32_t network_feature_count(const Network *network) {
    return network->width[network->layers - 1] + 1;
}

/* _Selection.__init__ */
static void take_selection(Features *self, const FeatureSelection *selection) {
    self->selection = *selection;
    for (int i = 0; i < selection->count; i++) {
        self->inverse[i] = REAL(1.0) / selection->scale[i];
    }
}

/* The rows of a layer. */
static const real *rows_of(const Network *network, int32_t inputs, int32_t layer) {
    const real *rows = network->parameters;
    for (int32_t l = 0; l < layer; l++) {
        rows += network->width[l] * (inputs + 1);
        inputs = network->width[l];
    }
    return rows;
}

/* NetworkFeatures.__init__ */
void features_init_network(Features *self, const FeatureSelection *selection, const Network *network) {
    features_take_network(self, selection, network);
    for (int32_t l = 0; l < network->layers; l++) {
        features_take_layer(self, l);
    }
}

void features_take_network(Features *self, const FeatureSelection *selection, const Network *network) {
    self->kind = ADAPTIVE_FEATURES_NETWORK;
    take_selection(self, selection);
    self->network = *network;
    self->feature_count = network_feature_count(network);
    memset(self->last_layer, 0, sizeof self->last_layer);
#ifdef DMRAC_Q15_FEATURES
    self->q15 = true;
#endif
}

void features_take_layer(Features *self, int32_t layer) {
#ifdef DMRAC_Q15_FEATURES
    self->q15 = whole_take_layer(&self->whole, &self->network, self->selection.count, layer) && self->q15;
#else
    (void)self;
    (void)layer;
#endif
}

/* halton */
real halton(int index, int dimension) {
    static const int primes[INPUTS_MAX] = {2,  3,  5,  7,  11, 13, 17, 19, 23, 29, 31,
                                           37, 41, 43, 47, 53, 59, 61, 67, 71, 73};
    int base = primes[dimension];
    real value = REAL(0.0), fraction = REAL(1.0);
    while (index > 0) {
        fraction /= (real)base;
        value += fraction * (real)(index % base);
        index /= base;
    }
    return value;
}

/* RadialFeatures.__init__ */
void features_init_radial(Features *self, const FeatureSelection *selection, real width) {
    self->kind = ADAPTIVE_FEATURES_RBF;
    take_selection(self, selection);
    self->feature_count = RBF_COUNT + 1;
    int m = selection->count;
    real divisor = REAL(2.0) * width * width * (real)m;
    for (int row = 0; row < RBF_COUNT; row++) {
        real *exponent = self->exponent + row * (2 * m + 1);
        real squares = REAL(0.0);
        for (int i = 0; i < m; i++) {
            real centre = REAL(2.0) * halton(row + 1, i) - REAL(1.0);
            exponent[i] = REAL(2.0) * centre / divisor;
            exponent[m + i] = REAL(-1.0) / divisor;
            squares += centre * centre;
        }
        exponent[2 * m] = -squares / divisor;
    }
}

/* BiasFeatures */
void features_init_bias(Features *self) {
    self->kind = ADAPTIVE_FEATURES_BIAS;
    self->selection.count = 0;
    self->feature_count = 1;
}

void features_copy(Features *self, const Features *from) {
    const Network *network = &from->network;
    int32_t inputs = from->selection.count, parameters = 0;
    self->kind = from->kind;
    self->feature_count = from->feature_count;
    self->selection = from->selection;
    memcpy(self->inverse, from->inverse, sizeof self->inverse);
    memcpy(self->exponent, from->exponent, sizeof self->exponent);
    memcpy(self->last_layer, from->last_layer, (size_t)(3 * from->feature_count) * sizeof(real));
    self->network.layers = network->layers;
    memcpy(self->network.width, network->width, sizeof network->width);
    for (int32_t l = 0; from->kind == ADAPTIVE_FEATURES_NETWORK && l < network->layers; l++) {
        parameters += network->width[l] * (inputs + 1);
        inputs = network->width[l];
    }
    memcpy(self->network.parameters, network->parameters, (size_t)parameters * sizeof(real));
#ifdef DMRAC_Q15_FEATURES
    self->q15 = from->q15;
    memcpy(self->whole.pairs, from->whole.pairs, (size_t)(parameters / 2) * sizeof(int32_t));
    memcpy(self->whole.biases, from->whole.biases, sizeof self->whole.biases);
    memcpy(self->whole.bits, from->whole.bits, sizeof self->whole.bits);
#endif
}

real features_layer_norm(const Features *self, int32_t layer, NormWorkspace *work) {
#ifdef DMRAC_Q15_FEATURES
    if (self->q15) {
        return q15_layer_norm(self, layer, work);
    }
#endif
    const Network *network = &self->network;
    int32_t inputs = layer > 0 ? network->width[layer - 1] : self->selection.count;
    const real *rows = rows_of(network, self->selection.count, layer);
    return largest_singular_value(rows, network->width[layer], inputs, inputs + 1, work->numbers);
}

/* ChannelFeatures.lipschitz_bound */
real network_lipschitz(const Network *network, int32_t inputs, real *work) {
    real product = REAL(1.0);
    const real *layer = network->parameters;
    for (int l = 0; l < network->layers; l++) {
        int rows = network->width[l], stride = inputs + 1; /* b stands after each row of W */
        product *= largest_singular_value(layer, rows, inputs, stride, work);
        layer += rows * stride;
        inputs = rows;
    }
    return product;
}

/* _Selection.select: z = (x - offset) / scale, clipped to +-INPUT_LIMIT */
void features_select(const Features *self, const real signals[SIGNAL_COUNT], real *z) {
    for (int i = 0; i < self->selection.count; i++) {
        real scaled = (signals[self->selection.index[i]] - self->selection.offset[i]) * self->inverse[i];
        z[i] = real_max(real_min(scaled, INPUT_LIMIT), -INPUT_LIMIT);
    }
}

/* NetworkFeatures.evaluate: Phi = [tanh(W_L ... tanh(W_1 z + b_1) + b_L); 1] */
static void evaluate_network(const Features *self, const real *z, real *Phi) {
#ifdef DMRAC_Q15_FEATURES
    if (self->q15) {
        q15_evaluate_real(self, z, Phi);
        return;
    }
#endif
    real levels[2][WIDTH_MAX];
    const Network *network = &self->network;
    const real *row = network->parameters;
    const real *below = z;
    int inputs = self->selection.count;
    for (int l = 0; l < network->layers; l++) {
        real *above = l == network->layers - 1 ? Phi : levels[l % 2];
        for (int i = 0; i < network->width[l]; i++) {
            above[i] = real_tanh(dot(row, below, inputs) + row[inputs]);
            row += inputs + 1;
        }
        inputs = network->width[l];
        below = above;
    }
    Phi[inputs] = REAL(1.0);
}

/* RadialFeatures.evaluate: phi_i = exp(-|z - c_i|^2 / (2 width^2 m)); then 1 */
static void evaluate_radial(const Features *self, const real *z, real *Phi) {
    int m = self->selection.count;
    for (int row = 0; row < RBF_COUNT; row++) {
        const real *exponent = self->exponent + row * (2 * m + 1);
        real sum = exponent[2 * m];
        for (int i = 0; i < m; i++) {
            sum += exponent[i] * z[i] + exponent[m + i] * (z[i] * z[i]);
        }
        Phi[row] = real_exp(sum);
    }
    Phi[RBF_COUNT] = REAL(1.0);
}

void features_evaluate(const Features *self, const real *z, real *Phi) {
    switch (self->kind) {
        case ADAPTIVE_FEATURES_NETWORK:
            evaluate_network(self, z, Phi);
            break;
        case ADAPTIVE_FEATURES_RBF:
            evaluate_radial(self, z, Phi);
            break;
        case ADAPTIVE_FEATURES_BIAS:
            Phi[0] = REAL(1.0);
            break;
    }
}

void features_at(const Features *self, const real *signals, int32_t n, real *Phi, int32_t stride) {
#ifdef DMRAC_Q15_FEATURES
    if (self->kind == ADAPTIVE_FEATURES_NETWORK && self->q15) {
        q15_features_at(self, signals, n, Phi, stride);
        return;
    }
#endif
    real z[INPUTS_MAX];
    for (int32_t i = 0; i < n; i++) {
        features_select(self, signals + i * SIGNAL_COUNT, z);
        features_evaluate(self, z, Phi + i * stride);
    }
}

/* dz/dx of an input: zero where it is clipped */
static real slope_of_input(const Features *self, const real *z, int32_t input) {
    return real_abs(z[input]) < INPUT_LIMIT ? self->inverse[input] : REAL(0.0);
}

/* NetworkFeatures.slope: D_L W_L ... D_1 W_1 dz/dx with D_i = diag(1 - h_i^2), h_i the outputs of layer i */
static void slope_of_network(const Features *self, const real *z, const int32_t *inputs, int32_t n, real *J,
                             real *work) {
#ifdef DMRAC_Q15_FEATURES
    if (self->q15) {
        q15_slope_real(self, z, inputs, n, J);
        return;
    }
#endif
    real levels[2][WIDTH_MAX];
    const Network *network = &self->network;
    const real *row = network->parameters, *below = z, *J_below = NULL;
    int count = self->selection.count;
    for (int l = 0; l < network->layers; l++) {
        real *above = levels[l % 2], *J_above = (network->layers - 1 - l) % 2 == 0 ? J : work;
        for (int i = 0; i < network->width[l]; i++, row += count + 1) {
            above[i] = real_tanh(dot(row, below, count) + row[count]);
            real steepness = REAL(1.0) - above[i] * above[i];
            for (int j = 0; j < n; j++) {
                real sum = REAL(0.0);
                if (l == 0) {
                    sum = row[inputs[j]] * slope_of_input(self, z, inputs[j]);
                } else {
                    for (int m = 0; m < count; m++) {
                        sum += row[m] * J_below[m * n + j];
                    }
                }
                J_above[i * n + j] = sum * steepness;
            }
        }
        count = network->width[l];
        below = above;
        J_below = J_above;
    }
}

/* RadialFeatures.slope: dphi_i/dx = (c_i - z)' / (width^2 m) phi_i dz/dx */
static void slope_of_radial(const Features *self, const real *z, const int32_t *inputs, int32_t n, real *J) {
    int m = self->selection.count;
    real Phi[RBF_COUNT + 1];
    evaluate_radial(self, z, Phi);
    for (int row = 0; row < RBF_COUNT; row++) {
        const real *exponent = self->exponent + row * (2 * m + 1);
        for (int j = 0; j < n; j++) {
            int32_t i = inputs[j];
            real towards = exponent[i] + REAL(2.0) * exponent[m + i] * z[i];
            J[row * n + j] = towards * Phi[row] * slope_of_input(self, z, i);
        }
    }
}

/* Features.slope */
void features_slope(const Features *self, const real *z, const int32_t *inputs, int32_t n, real *J, real *work) {
    switch (self->kind) {
        case ADAPTIVE_FEATURES_NETWORK:
            slope_of_network(self, z, inputs, n, J, work);
            break;
        case ADAPTIVE_FEATURES_RBF:
            slope_of_radial(self, z, inputs, n, J);
            break;
        case ADAPTIVE_FEATURES_BIAS: /* no feature but the constant */
            break;
    }
}

void features_of_states(const Features *self, const real *states, int32_t n, real *Phi) {
    real column[FEATURES_MAX];
    for (int i = 0; i < n; i++) {
        features_at(self, states + i * SIGNAL_COUNT, 1, column, 0);
        for (int j = 0; j < self->feature_count; j++) {
            Phi[j * n + i] = column[j];
        }
    }
}
