#include "control/slope.h"

#include <string.h>

#include "control/features_q15.h"
#include "control/reference_model.h"
#include "numerics/elementary.h"

/* Roll moves the vehicle east and pitch north; yaw gets the gains of the vertical axis. */
static const int MOVED_BY[3] = {1, 0, 2};

/* The limit of a kind: a share of the loop's gain. */
static void add_group(SlopeLimits *out, Signal first, real share, const real gain[3]) {
    out->first[out->groups] = (int32_t)first;
    for (int axis = 0; axis < 3; axis++) {
        out->limit[3 * out->groups + axis] = share * gain[axis];
    }
    out->groups++;
}

/* SlopeLimits.of */
void slope_limits_of(int32_t channel, const ChannelGains *position, const ChannelGains *attitude,
                     const SlopeShares *shares, SlopeLimits *out) {
    real stiffness[3], rate[3], turn[3], turn_rate[3], place[3], motion[3];
    out->groups = 0;
    gains_stiffness(position, stiffness);
    gains_rate_gain(position, rate);
    if (channel == 0) {
        add_group(out, SIGNAL_POSITION_N, shares->place, stiffness);
        add_group(out, SIGNAL_VELOCITY_N, shares->motion, rate);
        add_group(out, SIGNAL_BODY_VELOCITY_X, shares->motion, rate);
        return;
    }
    gains_stiffness(attitude, turn);
    gains_rate_gain(attitude, turn_rate);
    for (int axis = 0; axis < 3; axis++) {
        place[axis] = turn[axis] * stiffness[MOVED_BY[axis]] / GRAVITY;
        motion[axis] = turn[axis] * rate[MOVED_BY[axis]] / GRAVITY;
    }
    add_group(out, SIGNAL_ROLL, shares->turn, turn);
    add_group(out, SIGNAL_RATE_P, shares->turn, turn_rate);
    add_group(out, SIGNAL_POSITION_N, shares->place, place);
    add_group(out, SIGNAL_VELOCITY_N, shares->motion, motion);
    add_group(out, SIGNAL_BODY_VELOCITY_X, shares->motion, motion);
}

const real *slope_limits_at(const SlopeLimits *self, Signal first) {
    for (int group = 0; group < self->groups; group++) {
        if (self->first[group] == (int32_t)first) {
            return self->limit + 3 * group;
        }
    }
    return NULL;
}

/* Outputs of all layers, WIDTH_MAX apart, and where the rows of each layer begin. */
typedef struct {
    real z[INPUTS_MAX];
    real inside[INPUTS_MAX]; /* 1 / scale, or 0 for an input that is clipped */
    real levels[LAYERS_MAX * WIDTH_MAX];
    const real *rows[LAYERS_MAX];
} Pass;

static void forward(const Features *features, const real signals[SIGNAL_COUNT], Pass *pass) {
    const FeatureSelection *selection = &features->selection;
    const Network *network = &features->network;
    int inputs = selection->count;
    for (int i = 0; i < inputs; i++) {
        real z = (signals[selection->index[i]] - selection->offset[i]) / selection->scale[i];
        pass->inside[i] = real_abs(z) < INPUT_LIMIT ? REAL(1.0) / selection->scale[i] : REAL(0.0);
        pass->z[i] = real_max(real_min(z, INPUT_LIMIT), -INPUT_LIMIT);
    }
    const real *row = network->parameters, *below = pass->z;
    for (int l = 0; l < network->layers; l++) {
        real *above = pass->levels + l * WIDTH_MAX;
        pass->rows[l] = row;
        for (int i = 0; i < network->width[l]; i++, row += inputs + 1) {
            real sum = row[inputs];
            for (int j = 0; j < inputs; j++) {
                sum += row[j] * below[j];
            }
            above[i] = real_tanh(sum);
        }
        inputs = network->width[l];
        below = above;
    }
}

/* out [inputs] = slope [width] W of a layer. */
static void back(const real *rows, const real *slope, int width, int inputs, real *out) {
    for (int j = 0; j < inputs; j++) {
        out[j] = REAL(0.0);
    }
    for (int i = 0; i < width; i++, rows += inputs + 1) {
        for (int j = 0; j < inputs; j++) {
            out[j] += slope[i] * rows[j];
        }
    }
}

/* slopes */
void slopes(const Features *features, const real *theta, const real signals[SIGNAL_COUNT], real *slope) {
    const Network *network = &features->network;
    int m = features->selection.count;
    real of_layer[WIDTH_MAX], of_inputs[WIDTH_MAX];
    Pass pass;
    forward(features, signals, &pass);
    for (int axis = 0; axis < 3; axis++) {
        for (int i = 0; i < network->width[network->layers - 1]; i++) {
            of_inputs[i] = theta[3 * i + axis];
        }
        for (int l = network->layers - 1; l >= 0; l--) {
            const real *level = pass.levels + l * WIDTH_MAX;
            int width = network->width[l];
            for (int i = 0; i < width; i++) {
                of_layer[i] = of_inputs[i] * (REAL(1.0) - level[i] * level[i]);
            }
            back(pass.rows[l], of_layer, width, l > 0 ? network->width[l - 1] : m, of_inputs);
        }
        for (int i = 0; i < m; i++) {
            slope[axis * m + i] = of_inputs[i] * pass.inside[i];
        }
    }
}

/* The norm of a row's numbers at the three inputs of a kind. */
static real of_kind(const FeatureSelection *selection, const real *row, int32_t first) {
    real square = REAL(0.0);
    for (int i = 0; i < selection->count; i++) {
        if (selection->index[i] >= first && selection->index[i] < first + 3) {
            square += row[i] * row[i];
        }
    }
    return real_sqrt(square);
}

#ifdef DMRAC_Q15_FEATURES
/* largest_shares at one state, of a network in 16-bit whole numbers: over the inputs of the kinds alone. */
static void shares_in_whole(const Features *features, const real *theta, const SlopeLimits *limits, const real *signals,
                            real shares[3]) {
    int32_t inputs[INPUTS_MAX], group_of[INPUTS_MAX], n = 0;
    real z[INPUTS_MAX], slope[3 * INPUTS_MAX];
    for (int32_t i = 0; i < features->selection.count; i++) {
        for (int32_t group = 0; group < limits->groups; group++) {
            int32_t after = features->selection.index[i] - limits->first[group];
            if (after >= 0 && after < 3) {
                inputs[n] = i;
                group_of[n++] = group;
            }
        }
    }
    features_select(features, signals, z);
    q15_map_slope(features, theta, z, inputs, n, slope);
    for (int axis = 0; axis < 3; axis++) {
        real squares[SLOPE_GROUPS] = {REAL(0.0)};
        for (int32_t i = 0; i < n; i++) {
            squares[group_of[i]] += slope[axis * n + i] * slope[axis * n + i];
        }
        for (int32_t group = 0; group < limits->groups; group++) {
            real share = real_sqrt(squares[group]) / limits->limit[3 * group + axis];
            shares[axis] = real_largest(shares[axis], share);
        }
    }
}
#endif

/* largest_shares */
void largest_shares(const Features *features, const real *theta, const SlopeLimits *limits, const real *states,
                    int32_t n, real shares[3]) {
    real slope[3 * INPUTS_MAX];
    shares[0] = shares[1] = shares[2] = REAL(0.0);
    for (int i = 0; i < n; i++) {
#ifdef DMRAC_Q15_FEATURES
        if (features->q15) {
            shares_in_whole(features, theta, limits, states + i * SIGNAL_COUNT, shares);
            continue;
        }
#endif
        slopes(features, theta, states + i * SIGNAL_COUNT, slope);
        for (int axis = 0; axis < 3; axis++) {
            const real *row = slope + axis * features->selection.count;
            for (int group = 0; group < limits->groups; group++) {
                real share = of_kind(&features->selection, row, limits->first[group]) / limits->limit[3 * group + axis];
                shares[axis] = real_largest(shares[axis], share);
            }
        }
    }
}

/* flattened */
void flattened(real shares[3], const real *Phi, int32_t n, int32_t k, real *theta) {
    for (int axis = 0; axis < 3; axis++) {
        real factor = REAL(1.0) / real_largest(shares[axis], REAL(1.0));
        if (factor >= REAL(1.0)) { /* not NaN: theta is not finite then, and refused */
            continue;
        }
        real of_mean = REAL(0.0);
        for (int j = 0; j < k - 1; j++) {
            real sum = REAL(0.0);
            for (int i = 0; i < n; i++) {
                sum += Phi[i * FEATURES_MAX + j];
            }
            of_mean += theta[3 * j + axis] * (sum / (real)n);
            theta[3 * j + axis] *= factor;
        }
        theta[3 * (k - 1) + axis] += (REAL(1.0) - factor) * of_mean;
        shares[axis] *= factor;
    }
}
