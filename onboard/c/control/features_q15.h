/* Network features in 16-bit whole numbers, for processors without floating-point unit. No numpy twin: it is compared with
 * the features in `real`.
 *
 * Inputs have 13 fractional bits (|z| <= INPUT_LIMIT < 4), tanh 15. Each row of W and b has as many fractional bits as its
 * largest number and the sum of their sizes allow, at most 15, so that sums of 32 bits cannot overflow. tanh is read from a table of 257 points
 * over [0, 8] with linear interpolation: its error is at most 1.2e-4, and the rounding of a result 3e-5.
 *
 * Largest error of a feature, measured (tests/onboard/c/test_features.py): 3e-4 with the networks that a flight starts with,
 * 1.6e-3 with random ones whose Lipschitz constant is near 200, the largest that a swap accepts by default.
 *
 * With -DDMRAC_Q15_FEATURES the core evaluates its networks this way wherever it needs features, and their slopes too; the
 * library on the Mambo is built so (mambo/build.py). W and nu_ad are in `real` all the same. */
#ifndef DMRAC_FEATURES_Q15_H
#define DMRAC_FEATURES_Q15_H

#include "control/features.h"

#define TANH_POINTS 257

/* Pairs of the outputs of a layer, or of the inputs. */
#define PAIRS_MAX ((WIDTH_MAX + INPUTS_MAX + 1) / 2)

/* Search for the largest singular value: squarings of the Gram matrix, and products with a vector after them. */
#define NORM_SQUARINGS 2
#define NORM_STEPS 2

typedef struct {
    FeatureSelection selection;
    real inverse[INPUTS_MAX];
    Network network;
    WholeNetwork whole;
} FeaturesQ15;

/* Round a layer of a network with so many inputs. False if it holds a number of 2^15 or more, or a row whose numbers are that
 * large together. */
bool whole_take_layer(WholeNetwork *self, const Network *network, int32_t inputs, int32_t layer);

#ifdef DMRAC_Q15_FEATURES
/* Phi [k] at scaled inputs z, at n signal vectors, and J = dPhi/dx [k - 1, n], as features_evaluate, features_at and
 * features_slope give them. J is exact to about
 * 1e-3 of its largest number. */
void q15_evaluate_real(const Features *self, const real *z, real *Phi);
void q15_features_at(const Features *self, const real *signals, int32_t n, real *Phi, int32_t stride);
void q15_slope_real(const Features *self, const real *z, const int32_t *inputs, int32_t n, real *J);

/* d(theta'Phi)/dx [3, n], theta [k, 3]. */
void q15_map_slope(const Features *self, const real *theta, const real *z, const int32_t *inputs, int32_t n,
                   real *slope);

/* The spectral norm of a layer's W, exact to about 1 %; never larger by more than rounding. */
real q15_layer_norm(const Features *self, int32_t layer, NormWorkspace *work);
#endif

/* Round the network of `source`. Returns false if it holds a number of 2^15 or more. */
bool features_q15_init(FeaturesQ15 *self, const Features *source);

/* Scaled inputs [m], rounded, of a signal vector. */
void features_q15_select(const FeaturesQ15 *self, const real signals[SIGNAL_COUNT], int16_t *z);

/* Phi [k] of scaled inputs, as whole numbers over 2^15; the constant 1 is 32767, so the caller uses 1 for it. */
void features_q15_evaluate(const FeaturesQ15 *self, const int16_t *z, int16_t *Phi);

/* tanh of a number with 16 fractional bits, with 15 fractional bits. |x| at most 2^31 - 1. */
int16_t tanh_q15(int32_t x);

#endif
