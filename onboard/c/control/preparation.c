#include "control/preparation.h"

#include <string.h>

#include "numerics/elementary.h"

/* The next channel from `channel` on for which this is so; 2 if none. */
static int32_t next_of(const bool these[2], int32_t channel) {
    while (channel < 2 && !these[channel]) {
        channel++;
    }
    return channel;
}

/* Preparation.__init__ */
void preparation_begin(Preparation *self, const FeatureSet *features, const Augmentation *laws, const bool learns[2],
                       bool tested) {
    self->tested = tested;
    self->begun = false;
    self->refusal = REFUSAL_NONE;
    for (int32_t i = 0; i < 2; i++) {
        const ChannelFeatures *channel = features->channels + i;
        self->changes[i] = learns[i] && features->covers[i] && !adaptive_flies(&laws[i].adaptive, channel);
        self->swaps[i] = self->changes[i] && adaptive_prepare(&laws[i].adaptive, channel, self->posterior + i);
    }
    self->swapping = next_of(self->swaps, 0);
    self->sloping = self->looking = tested ? next_of(self->swaps, 0) : 2;
}

/* Preparation._check_slopes */
static void check_slopes(Preparation *self, const Augmentation *laws, VersionTest *tests) {
    PosteriorSwap *swap = self->posterior + self->sloping;
    VersionTest *test = tests + self->sloping;
    if (!self->begun) {
        ahead_begin_slopes(&test->ahead, test, laws[self->sloping].adaptive.signals);
    }
    self->begun = !ahead_steepest(&test->ahead, test, &swap->features, swap->theta, BOX_SLOPES_PER_PART);
    if (!self->begun) {
        self->sloping = next_of(self->swaps, self->sloping + 1);
    }
}

/* Preparation._look_ahead */
static void look_ahead(Preparation *self, const Augmentation *laws, VersionTest *tests) {
    PosteriorSwap *swap = self->posterior + self->looking;
    VersionTest *test = tests + self->looking;
    if (!self->begun) {
        ahead_begin(&test->ahead, test, laws[self->looking].adaptive.signals);
    }
    self->begun = !ahead_step(&test->ahead, test, &swap->features, swap->theta, AHEAD_PER_PART);
    if (!self->begun) {
        self->looking = next_of(self->swaps, self->looking + 1);
    }
}

/* Preparation.step */
bool preparation_step(Preparation *self, const Augmentation *laws, VersionTest *tests) {
    for (int32_t i = 0; i < 2; i++) {
        if (self->swaps[i]) {
            posterior_swap_follow(self->posterior + i, &laws[i].adaptive.kalman_layer, &laws[i].adaptive.recent);
        }
    }
    if (self->swapping < 2) {
        const Adaptive *learner = &laws[self->swapping].adaptive;
        PosteriorSwap *swap = self->posterior + self->swapping;
        if (posterior_swap_step(swap, &learner->config.swap, &learner->kalman_layer, &learner->slope_limits)) {
            self->swapping = next_of(self->swaps, self->swapping + 1);
        }
        self->refusal = swap->refusal;
    } else if (self->sloping < 2) {
        check_slopes(self, laws, tests);
    } else if (self->looking < 2) {
        look_ahead(self, laws, tests);
    }
    return self->refusal != REFUSAL_NONE || (self->swapping == 2 && self->looking == 2);
}

/* Preparation._verdict of a swap that was prepared */
static Refusal verdict(const PosteriorSwap *swap, VersionTest *test) {
    const real *shares = swap->shares;
    real over = real_largest(real_largest(shares[0], shares[1]), shares[2]);
    return version_test_verdict(test, swap->theta, swap->features.feature_count, &swap->map, over);
}

/* Preparation.plans */
Refusal preparation_plans(Preparation *self, const FeatureSet *features, const Augmentation *laws, VersionTest *tests) {
    for (int32_t i = 0; i < 2; i++) {
        const Adaptive *learner = &laws[i].adaptive;
        SwapPlan *plan = self->plans + i;
        if (!self->changes[i]) {
            continue;
        }
        if (self->swaps[i]) {
            adaptive_planned(learner, self->posterior + i, plan);
        } else {
            adaptive_plan(learner, features->channels + i, self->features + i, &self->work, plan);
        }
        Refusal refusal = plan->refusal;
        if (refusal == REFUSAL_NONE && self->tested && self->swaps[i]) {
            refusal = verdict(self->posterior + i, tests + i);
        } else if (refusal == REFUSAL_NONE && self->tested) {
            int32_t n = adaptive_recent(learner, self->work.states, self->work.residuals);
            refusal = version_test_refusal(tests + i, self->features + i, adaptive_prior_of(learner, plan),
                                           learner->signals, self->work.states, self->work.residuals, n);
        }
        if (refusal != REFUSAL_NONE) {
            return refusal;
        }
    }
    return REFUSAL_NONE;
}

const Features *preparation_features(const Preparation *self, int32_t channel) {
    return self->swaps[channel] ? &self->posterior[channel].features : self->features + channel;
}

real preparation_jump(const Preparation *self, const Augmentation *laws) {
    real jump = REAL(0.0);
    for (int32_t i = 0; i < 2; i++) {
        if (self->changes[i]) {
            jump += self->plans[i].step / adaptive_jump_max(&laws[i].adaptive);
        }
    }
    return jump;
}
