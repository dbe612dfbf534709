#include "control/laws/augmentation.h"

#include "control/laws/none.h"

/* _start_features */
static void start_features(Features *features, const AdaptiveConfig *config, const ChannelFeatures *start) {
    switch (config->features) {
        case ADAPTIVE_FEATURES_NETWORK:
            features_init_network(features, &start->selection, &start->network);
            break;
        case ADAPTIVE_FEATURES_RBF:
            features_init_radial(features, &start->selection, config->rbf_width);
            break;
        case ADAPTIVE_FEATURES_BIAS:
            features_init_bias(features);
            break;
    }
}

static void init_adaptive(Adaptive *self, const CascadeSettings *settings, int32_t channel, const ChannelSettings *own,
                          const ChannelFeatures *start) {
    SlopeLimits limits;
    SlopeShares shares = adaptive_slope_shares(&own->augmentation.adaptive);
    slope_limits_of(channel, &settings->position.gains, &settings->attitude.gains, &shares, &limits);
    start_features(&self->features, &own->augmentation.adaptive, start);
    adaptive_init(self, &own->augmentation.adaptive, &own->gains, &limits);
}

/* _augmentation */
void augmentation_init(Augmentation *self, const CascadeSettings *settings, int32_t channel,
                       const ChannelFeatures *start) {
    const ChannelSettings *own = channel == 0 ? &settings->position : &settings->attitude;
    const ChannelSettingsAugmentation *config = &own->augmentation;
    self->kind = config->kind;
    switch (config->kind) {
        case AUGMENTATION_NONE:
            break;
        case AUGMENTATION_INTEGRAL:
            integral_init(&self->integral, &config->integral);
            break;
        case AUGMENTATION_L1:
            l1_init(&self->l1, &config->l1);
            break;
        case AUGMENTATION_INDI:
            indi_init(&self->indi, &config->indi);
            break;
        case AUGMENTATION_REPETITIVE:
            repetitive_init(&self->repetitive, &config->repetitive);
            break;
        case AUGMENTATION_ILC:
            ilc_init(&self->ilc, &config->ilc, &own->gains);
            break;
        case AUGMENTATION_ADAPTIVE:
            init_adaptive(&self->adaptive, settings, channel, own, start);
            break;
    }
}

/* Augmentation.step */
void augmentation_step(Augmentation *self, const ChannelState *channel, ChannelTelemetry *telemetry, real nu_ad[3]) {
    switch (self->kind) {
        case AUGMENTATION_NONE:
            none_step(nu_ad);
            break;
        case AUGMENTATION_INTEGRAL:
            integral_step(&self->integral, channel, telemetry, nu_ad);
            break;
        case AUGMENTATION_L1:
            l1_step(&self->l1, channel, telemetry, nu_ad);
            break;
        case AUGMENTATION_INDI:
            indi_step(&self->indi, channel, telemetry, nu_ad);
            break;
        case AUGMENTATION_REPETITIVE:
            repetitive_step(&self->repetitive, channel, telemetry, nu_ad);
            break;
        case AUGMENTATION_ILC:
            ilc_step(&self->ilc, channel, telemetry, nu_ad);
            break;
        case AUGMENTATION_ADAPTIVE:
            adaptive_step(&self->adaptive, channel, telemetry, nu_ad);
            break;
    }
}

/* Augmentation.reset */
void augmentation_reset(Augmentation *self) {
    switch (self->kind) {
        case AUGMENTATION_NONE:
            break;
        case AUGMENTATION_INTEGRAL:
            integral_reset(&self->integral);
            break;
        case AUGMENTATION_L1:
            l1_reset(&self->l1);
            break;
        case AUGMENTATION_INDI:
            indi_reset(&self->indi);
            break;
        case AUGMENTATION_REPETITIVE:
            repetitive_reset(&self->repetitive);
            break;
        case AUGMENTATION_ILC:
            ilc_reset(&self->ilc);
            break;
        case AUGMENTATION_ADAPTIVE:
            adaptive_reset(&self->adaptive);
            break;
    }
}

/* isinstance(augmentation, AdaptiveAugmentation) */
bool augmentation_has_features(const Augmentation *self) {
    return self->kind == AUGMENTATION_ADAPTIVE;
}

/* AdaptiveAugmentation.reads_path */
bool augmentation_reads_path(const Augmentation *self) {
    return augmentation_has_features(self) && adaptive_reads_path(&self->adaptive);
}

/* AdaptiveAugmentation.learns */
bool augmentation_learns(const Augmentation *self) {
    return augmentation_has_features(self) && adaptive_learns(&self->adaptive);
}
