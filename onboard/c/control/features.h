/* Features Phi(x, c), the inputs of the last layer: a learnt network, radial basis functions, or the bias alone. The twin
 * of onboard/control/features.py. The last feature is always the constant 1. */
#ifndef DMRAC_FEATURES_H
#define DMRAC_FEATURES_H

#include <stdbool.h>

#include "generated/config.h"
#include "generated/constants.h"

#define INPUTS_MAX SIGNAL_COUNT
#define FEATURES_MAX (WIDTH_MAX + 1)

/* Numbers of all inner layers together: W and b. A vehicle with little memory defines it smaller; networks that do not
 * fit are refused then. */
#ifndef PARAMETERS_MAX
#define PARAMETERS_MAX (LAYERS_MAX * WIDTH_MAX * (WIDTH_MAX + 1))
#endif

/* The inputs of a channel and their scales: z = (x - offset) / scale. */
typedef struct {
    int32_t count;
    int32_t index[INPUTS_MAX]; /* in the signal vector */
    real offset[INPUTS_MAX];   /* in the input's unit */
    real scale[INPUTS_MAX];    /* the same, positive */
} FeatureSelection;

/* Inner layers: for each layer, for each of its outputs, a row of W and then b. */
typedef struct {
    int32_t layers;
    int32_t width[LAYERS_MAX];
    real parameters[PARAMETERS_MAX];
} Network;

/* Inner layers in 16-bit whole numbers (features_q15.h). */
typedef struct {
    int32_t pairs[PARAMETERS_MAX / 2];      /* rows of W, two numbers in each */
    int32_t biases[LAYERS_MAX * WIDTH_MAX]; /* b of each row, all layers one after the other, as its sums are */
    int8_t bits[LAYERS_MAX * WIDTH_MAX];    /* fractional bits of each row of W */
} WholeNetwork;

/* One channel of a trained feature version. */
typedef struct {
    FeatureSelection selection;
    Network network;
    real last_layer[FEATURES_MAX * 3]; /* theta_n, [k, 3], units of the channel's u */
} ChannelFeatures;

/* A trained feature version: the twin of protocol/feature_set.py FeatureSet. */
typedef struct {
    int64_t version;
    int64_t parent;
    int64_t samples;
    bool covers[2]; /* which of `channels` it has: position, attitude */
    ChannelFeatures channels[2];
} FeatureSet;

typedef struct {
    AdaptiveFeatures kind;
    int32_t feature_count; /* k, the constant included */
    FeatureSelection selection;
    real inverse[INPUTS_MAX]; /* 1 / scale */
    Network network;
    real last_layer[FEATURES_MAX * 3]; /* theta_n that came with the network; zero for a flight's first features */
    real exponent[RBF_COUNT * (2 * INPUTS_MAX + 1)]; /* of the radial functions, linear in [z; z^2; 1] */
#ifdef DMRAC_Q15_FEATURES
    bool q15; /* the network is evaluated in 16-bit whole numbers */
    WholeNetwork whole;
#endif
} Features;

/* Memory of a search for a spectral norm. */
typedef struct {
    real numbers[2 * WIDTH_MAX * WIDTH_MAX];
    int32_t whole[WIDTH_MAX * WIDTH_MAX];
} NormWorkspace;

/* A number of the Halton sequence (Halton 1960) in [0, 1): by its index, from 1, and its dimension, 0 to INPUTS_MAX - 1. */
real halton(int index, int dimension);

/* k of a network. */
int32_t network_feature_count(const Network *network);

/* Take over a network; `selection` and `network` are copied. `last_layer` is zero. The same without the layers, which
 * features_take_layer takes over one after the other, in their order, before the features are evaluated. */
void features_take_network(Features *self, const FeatureSelection *selection, const Network *network);
void features_take_layer(Features *self, int32_t layer);
void features_init_network(Features *self, const FeatureSelection *selection, const Network *network);
/* Gaussians on a Halton grid over the unit box. `width` in scaled units, for one input; it grows with sqrt(m). */
void features_init_radial(Features *self, const FeatureSelection *selection, real width);
void features_init_bias(Features *self);

/* Lipschitz constant of Phi in the scaled inputs: the product of the layers' spectral norms. `work`: 2 WIDTH_MAX^2
 * numbers. */
real network_lipschitz(const Network *network, int32_t inputs, real *work);

/* The same features as `from`: of its arrays only what is used is copied. */
void features_copy(Features *self, const Features *from);

/* The spectral norm of a layer's W, which has been taken over. In 16-bit whole numbers it is exact to about 1 %. */
real features_layer_norm(const Features *self, int32_t layer, NormWorkspace *work);

/* Scaled inputs z [m] of a signal vector, clipped to +-INPUT_LIMIT. */
void features_select(const Features *self, const real signals[SIGNAL_COUNT], real *z);

/* Phi [k] of scaled inputs. */
void features_evaluate(const Features *self, const real *z, real *Phi);

/* Phi at n signal vectors: both at once. `signals` [n, SIGNAL_COUNT]; the Phi of each [k] stands `stride` behind the last one's. */
void features_at(const Features *self, const real *signals, int32_t n, real *Phi, int32_t stride);

/* J = dPhi/dx [k - 1, n] at scaled inputs z, without the constant, over n of the inputs, in their units. Zero in an input that
 * is clipped. J and `work` have room for WIDTH_MAX n numbers. */
void features_slope(const Features *self, const real *z, const int32_t *inputs, int32_t n, real *J, real *work);

/* Phi [k, n] of the signal vectors `states` [n, SIGNAL_COUNT]. */
void features_of_states(const Features *self, const real *states, int32_t n, real *Phi);

#endif
