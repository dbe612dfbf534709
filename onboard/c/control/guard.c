#include "control/guard.h"

#include <string.h>

#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* Guard._watch */
static void init_watch(Guard *self, int32_t channel, const Adaptive *learner, const ChannelGains *gains) {
    watch_init(self->watches + channel, &self->config.watch, channel, gains, adaptive_composite_gain(learner),
               adaptive_tracking_gain(learner), &learner->tracking_weights);
}

/* Guard._learnt */
static void keep_as_good(Guard *self, const Augmentation *augmentations) {
    self->good.version = self->version;
    memcpy(self->good.content, self->content, sizeof self->content);
    for (int channel = 0; channel < 2; channel++) {
        if (self->learns[channel]) {
            adaptive_learnt(&augmentations[channel].adaptive, self->good.learnt + channel);
        }
    }
}

/* Guard.__init__ */
void guard_init(Guard *self, const GuardConfig *config, const Augmentation *augmentations, const ChannelGains *position,
                const ChannelGains *attitude, const AirframeConfig *airframe, real tilt_max_rad) {
    const ChannelGains *gains[2] = {position, attitude};
    memset(self, 0, sizeof *self);
    self->config = *config;
    room_init(&self->room, &config->room, airframe, tilt_max_rad);
    for (int channel = 0; channel < 2; channel++) {
        self->learns[channel] = augmentation_learns(augmentations + channel);
        if (self->learns[channel]) {
            const Adaptive *learner = &augmentations[channel].adaptive;
            init_watch(self, channel, learner, gains[channel]);
            version_test_init(self->tests + channel, &config->test, channel, &learner->slope_limits);
        }
    }
    self->level = LEVEL_MAP;
    self->proven = true;
    keep_as_good(self, augmentations);
}

/* --- every tick --- */

/* _within: nu within its room; whether that changed it */
static bool keep_within(const real room[3], real nu[3]) {
    bool limited = false;
    for (int axis = 0; axis < 3; axis++) {
        real bounded = real_min(real_max(nu[axis], -room[axis]), room[axis]);
        limited = limited || (bounded != nu[axis] && nu[axis] == nu[axis]);
        nu[axis] = bounded;
    }
    return limited;
}

/* Guard.step */
void guard_step(Guard *self, Augmentation *augmentations, int32_t channel, const ChannelState *state,
                ChannelTelemetry *telemetry, const ControlInputs *inputs, real nu_ad[3]) {
    real need[3];
    vector_add(telemetry->demand, telemetry->adaptive, need); /* of the tick before */
    augmentation_step(augmentations + channel, state, telemetry, nu_ad);
    if (self->learns[channel]) {
        ChannelWatch *watch = self->watches + channel;
        if (state->adapt) {
            watch_step(watch, state, telemetry->residual, telemetry->adaptive_now, nu_ad, (int32_t)self->level);
        }
        if (self->level != LEVEL_MAP) {
            vector_zero(nu_ad);
            if (self->level == LEVEL_BIAS) {
                vector_copy(watch->d, nu_ad);
            }
            vector_copy(nu_ad, telemetry->adaptive_now);
        }
        if (self->config.room.enabled) {
            if (channel == 0) {
                room_position(&self->room, inputs->thrust_scale, need, telemetry->room);
            } else {
                room_attitude(&self->room, inputs->thrust_scale, inputs->thrust_n, need, telemetry->room);
            }
            self->limited[channel] += keep_within(telemetry->room, nu_ad) ? 1 : 0;
            keep_within(telemetry->room, telemetry->adaptive_now);
        }
    }
    vector_copy(nu_ad, telemetry->adaptive);
}

/* Guard._enter */
static void enter(Guard *self, Level level) {
    self->level = level;
    for (int channel = 0; channel < 2; channel++) {
        watch_restart(self->watches + channel);
    }
}

/* Guard._say: a fall, of the law and the version that fly now */
static void say(Guard *self, Fall fall) {
    fall.level = self->level;
    fall.flying = self->version;
    if (self->fall_count < FALLS_MAX) {
        self->falls[self->fall_count++] = fall;
    } else {
        self->falls_lost++;
    }
}

static bool is_refused(const Guard *self, const uint8_t content[CONTENT_BYTES]) {
    for (int32_t i = 0; i < self->refused_count; i++) {
        if (memcmp(self->refused + i * CONTENT_BYTES, content, CONTENT_BYTES) == 0) {
            return true;
        }
    }
    return false;
}

/* A version was taken back: its content is remembered. */
static void strike(Guard *self) {
    self->strikes++;
    if (!is_refused(self, self->content) && self->refused_count < CONTENTS_MAX) {
        memcpy(self->refused + self->refused_count * CONTENT_BYTES, self->content, CONTENT_BYTES);
        self->refused_count++;
    }
}

/* Whether too many versions have been taken back for another one to be accepted. */
static bool trusts_none(const Guard *self) {
    return self->strikes >= self->config.strikes_max || self->refused_count == CONTENTS_MAX;
}

/* Guard._take_back: from an unproven version to the last good one, and what the law had learnt with it */
static void take_back(Guard *self, Augmentation *augmentations, Fall fall) {
    fall.refused = self->version;
    for (int i = 0; i < 2; i++) {
        if (self->learns[i]) {
            adaptive_restore(&augmentations[i].adaptive, self->good.learnt + i, self->watches[i].d);
        }
    }
    self->version = self->good.version;
    memcpy(self->content, self->good.content, sizeof self->content);
    self->proven = true;
    enter(self, LEVEL_MAP);
    fall.kind = FALL_BACK;
    say(self, fall);
}

/* Guard._fall: one step back, to the last good version or to the next simpler law */
static void fall_back(Guard *self, Augmentation *augmentations, FallReason reason, int32_t channel) {
    Fall fall = {.kind = FALL_SIMPLER, .reason = reason, .channel = channel};
    fall.refused = self->level == LEVEL_MAP ? self->version : 0;
    bool back = self->level == LEVEL_MAP && self->version != self->good.version;
    if (fall.refused != 0) {
        strike(self);
    }
    if (back) {
        take_back(self, augmentations, fall);
    } else {
        self->needs_evidence = true;
        enter(self, (Level)(self->level + 1));
        say(self, fall);
    }
}

/* Guard._loses: whether the version that flies is worse than the bias so far, in a channel that has some evidence */
static bool loses(const Guard *self) {
    return (self->learns[0] && watch_loses(self->watches, LOSES_S)) ||
           (self->learns[1] && watch_loses(self->watches + 1, LOSES_S));
}

/* Guard._informed: the number of channels with enough evidence, and whether the map stands in all of them */
static int32_t informed(const Guard *self, real evidence_s, bool *stands) {
    int32_t count = 0;
    *stands = true;
    for (int channel = 0; channel < 2; channel++) {
        const ChannelWatch *watch = self->watches + channel;
        if (self->learns[channel] && watch->evidence_s >= evidence_s) {
            count++;
            *stands = *stands && watch_stands(watch, evidence_s);
        }
    }
    return count;
}

/* Guard._may_fly: whether the map that runs beside the bias-only law has passed its audition */
static bool may_fly(const Guard *self, const WatchConfig *config) {
    bool stands, agrees = !self->needs_evidence;
    bool has_evidence = informed(self, config->audition_s, &stands) > 0;
    for (int channel = 0; channel < 2; channel++) {
        const ChannelWatch *watch = self->watches + channel;
        if (self->learns[channel]) {
            agrees = agrees && watch->agreed_s >= config->agreement_s;
            stands = stands && watch_worse(watch, 0, 1) == WATCH_NO_WORSE;
        }
    }
    return !trusts_none(self) && (has_evidence || agrees) && stands;
}

/* Guard._look_ahead: check the map that flies on what is ahead now, one channel in a tick, attitude first */
static void look_ahead(Guard *self, Augmentation *augmentations) {
    if (!self->config.test.enabled || self->version == 0) {
        return;
    }
    if (!self->due[0] && !self->due[1] && self->time_s >= self->next_check_s) {
        self->next_check_s = self->time_s + (double)self->config.test.check_s;
        memcpy(self->due, self->learns, sizeof self->due);
    }
    int channel = self->due[1] ? 1 : 0;
    if (self->due[channel]) {
        const Adaptive *learner = &augmentations[channel].adaptive;
        self->due[channel] = false;
        if (!version_test_still_good(self->tests + channel, &learner->features, adaptive_prior_layer(learner),
                                     learner->signals)) {
            fall_back(self, augmentations, FALL_AHEAD, channel);
        }
    }
}

/* Guard.judge */
void guard_judge(Guard *self, Augmentation *augmentations, real dt, bool adapting) {
    bool stands;
    self->time_s += (double)dt;
    self->adapting = adapting;
    if (!(self->learns[0] || self->learns[1]) || !adapting || !self->config.watch.enabled) {
        return;
    }
    for (int channel = 0; channel < 2; channel++) {
        const ChannelWatch *watch = self->watches + channel;
        if (self->learns[channel] && watch_failed(watch) && self->level != LEVEL_NONE) {
            WatchFinding why = watch_worse(watch, (int32_t)self->level, (int32_t)self->level + 1);
            FallReason reason = why == WATCH_MODEL_ERROR ? FALL_MODEL_ERROR
                                : why == WATCH_TRIAL     ? FALL_TRIAL
                                                         : FALL_MISFIT;
            fall_back(self, augmentations, reason, channel);
            return;
        }
    }
    if (self->level == LEVEL_MAP) {
        if (!self->proven && informed(self, self->config.watch.proof_s, &stands) > 0 && stands) {
            self->proven = true;
            self->losses = 0;
        }
        look_ahead(self, augmentations);
    } else if (self->level == LEVEL_BIAS && may_fly(self, &self->config.watch)) {
        enter(self, LEVEL_MAP);
        say(self, (Fall){.kind = FALL_UP});
    }
}

/* Guard.take_falls */
int32_t guard_take_falls(Guard *self, Fall *falls) {
    int32_t count = self->fall_count;
    memcpy(falls, self->falls, (size_t)count * sizeof *falls);
    self->fall_count = 0;
    return count;
}

/* Guard.reset */
void guard_reset(Guard *self) {
    for (int channel = 0; channel < 2; channel++) {
        watch_reset(self->watches + channel);
        watch_restart(self->watches + channel);
    }
    if (self->level == LEVEL_NONE) {
        self->level = LEVEL_BIAS;
    }
    self->adapting = false;
}

/* --- versions --- */

/* Guard._plans, of one channel */
static Refusal plan_channel(Guard *self, const Adaptive *learner, int32_t channel, const ChannelFeatures *offered) {
    OfferWorkspace *work = &self->work;
    Features *features = work->features + channel;
    SwapPlan *plan = work->plans + channel;
    adaptive_plan(learner, offered, features, &work->swap, plan);
    work->planned[channel] = true;
    if (plan->refusal != REFUSAL_NONE || !self->config.test.enabled) {
        return plan->refusal;
    }
    int32_t n = adaptive_recent(learner, work->swap.states, work->swap.residuals);
    return version_test_refusal(self->tests + channel, features, adaptive_prior_of(learner, plan), learner->signals,
                                work->swap.states, work->swap.residuals, n);
}

/* Guard._plans: of the channels whose features would change; a swap to the same would forget S */
static Refusal plan_all(Guard *self, const Augmentation *augmentations, const FeatureSet *features) {
    Refusal refusal = REFUSAL_NONE;
    self->work.planned[0] = self->work.planned[1] = false;
    for (int channel = 0; channel < 2 && refusal == REFUSAL_NONE; channel++) {
        const Adaptive *learner = &augmentations[channel].adaptive;
        const ChannelFeatures *offered = features->channels + channel;
        if (self->learns[channel] && features->covers[channel] && !adaptive_flies(learner, offered)) {
            refusal = plan_channel(self, learner, channel, offered);
        }
    }
    return refusal;
}

/* Guard._too_often: whether one more swap would be too many in a second, or too much */
static Refusal too_often(Guard *self, const Augmentation *augmentations) {
    real jump = REAL(0.0), jumps = REAL(0.0);
    bool planned = false;
    for (int channel = 0; channel < 2; channel++) {
        if (self->work.planned[channel]) {
            jump += self->work.plans[channel].step / adaptive_jump_max(&augmentations[channel].adaptive);
            planned = true;
        }
    }
    while (self->swap_count > 0 && self->swap_times_s[self->swap_first] < self->time_s - 1.0) {
        self->swap_first = (self->swap_first + 1) % SWAPS_MAX;
        self->swap_count--;
    }
    for (int32_t i = 0; i < self->swap_count; i++) {
        jumps += self->swap_jumps[(self->swap_first + i) % SWAPS_MAX];
    }
    if ((real)(self->swap_count + 1) > self->config.swaps_per_s_max || jumps + jump > self->config.jumps_max ||
        self->swap_count == SWAPS_MAX) {
        return REFUSAL_SWAP_RATE;
    }
    if (planned) {
        int32_t last = (self->swap_first + self->swap_count++) % SWAPS_MAX;
        self->swap_times_s[last] = self->time_s;
        self->swap_jumps[last] = jump;
    }
    return REFUSAL_NONE;
}

/* Carry out the plans, all of them. */
static void commit_all(Guard *self, Augmentation *augmentations) {
    for (int channel = 0; channel < 2; channel++) {
        if (self->work.planned[channel]) {
            adaptive_commit(&augmentations[channel].adaptive, self->work.features + channel,
                            self->work.plans + channel);
        }
    }
}

static bool plans_any(const Guard *self) {
    return self->work.planned[0] || self->work.planned[1];
}

/* Guard._renumber: what flies has come again under another number */
static void renumber(Guard *self, int64_t version) {
    if (self->good.version == self->version) {
        self->good.version = version;
    }
    self->version = version;
}

/* Guard.offer */
Refusal guard_offer(Guard *self, Augmentation *augmentations, const FeatureSet *features) {
    uint8_t content[CONTENT_BYTES];
    if (!(self->learns[0] && features->covers[0]) && !(self->learns[1] && features->covers[1])) {
        return REFUSAL_NOT_ACCEPTING;
    }
    feature_content(features, content);
    if (is_refused(self, content)) {
        return REFUSAL_TAKEN_BACK;
    }
    if (trusts_none(self)) {
        return REFUSAL_NOT_TRUSTED;
    }
    Refusal refusal = plan_all(self, augmentations, features);
    refusal = refusal == REFUSAL_NONE ? too_often(self, augmentations) : refusal;
    if (refusal == REFUSAL_NONE && plans_any(self) && self->level == LEVEL_MAP && !self->proven &&
        self->config.watch.enabled && loses(self)) {
        self->losses++;
        take_back(self, augmentations, (Fall){.reason = FALL_BEFORE});
        refusal = plan_all(self, augmentations, features);
    }
    if (refusal != REFUSAL_NONE) {
        return refusal;
    }
    if (!plans_any(self)) {
        renumber(self, features->version);
        return REFUSAL_NONE;
    }
    if (self->proven && self->level == LEVEL_MAP) {
        keep_as_good(self, augmentations);
    }
    commit_all(self, augmentations);
    self->version = features->version;
    memcpy(self->content, content, sizeof content);
    self->proven = false;
    self->needs_evidence = self->losses >= self->config.losses_max;
    bool at_once = self->adapting && self->level == LEVEL_MAP && !self->needs_evidence;
    enter(self, at_once || !self->config.watch.enabled ? LEVEL_MAP : LEVEL_BIAS);
    return REFUSAL_NONE;
}
