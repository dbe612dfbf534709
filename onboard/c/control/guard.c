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
        self->tests[channel].looks = self->due[channel] = false;
    }
    self->next_check_s = self->time_s;
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

/* Guard._look_ahead: check the map that flies on what is ahead now, some states in a tick, attitude first */
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
        VersionTest *test = self->tests + channel;
        if (!version_test_look(test, &learner->features, adaptive_prior_layer(learner), learner->signals)) {
            return;
        }
        self->due[channel] = false;
        if (!test->good) {
            fall_back(self, augmentations, FALL_AHEAD, channel);
        }
    }
}

/* Guard.judge */
void guard_judge(Guard *self, Augmentation *augmentations, real dt, bool adapting, bool busy) {
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
        self->waits = busy && self->waits < LOOK_WAITS_MAX ? self->waits + 1 : 0;
        if (self->waits == 0) {
            look_ahead(self, augmentations);
        }
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

/* Guard._too_often: whether one more swap would be too many in a second, or too much */
static bool too_often(Guard *self, real jump) {
    real jumps = REAL(0.0);
    while (self->swap_count > 0 && self->swap_times_s[self->swap_first] < self->time_s - 1.0) {
        self->swap_first = (self->swap_first + 1) % SWAPS_MAX;
        self->swap_count--;
    }
    for (int32_t i = 0; i < self->swap_count; i++) {
        jumps += self->swap_jumps[(self->swap_first + i) % SWAPS_MAX];
    }
    return (real)(self->swap_count + 1) > self->config.swaps_per_s_max || jumps + jump > self->config.jumps_max ||
           self->swap_count == SWAPS_MAX;
}

static void note_swap(Guard *self, real jump) {
    int32_t last = (self->swap_first + self->swap_count++) % SWAPS_MAX;
    self->swap_times_s[last] = self->time_s;
    self->swap_jumps[last] = jump;
}

/* Guard._renumber: what flies has come again under another number */
static void renumber(Guard *self, int64_t version) {
    if (self->good.version == self->version) {
        self->good.version = version;
    }
    self->version = version;
}

/* Guard._unwanted: the refusal of a version that need not be prepared */
static Refusal unwanted(const Guard *self, const FeatureSet *features, const uint8_t content[CONTENT_BYTES]) {
    if (!(self->learns[0] && features->covers[0]) && !(self->learns[1] && features->covers[1])) {
        return REFUSAL_NOT_ACCEPTING;
    }
    if (is_refused(self, content)) {
        return REFUSAL_TAKEN_BACK;
    }
    return trusts_none(self) ? REFUSAL_NOT_TRUSTED : REFUSAL_NONE;
}

/* Guard._commit */
static void commit(Guard *self, Augmentation *augmentations, int64_t version) {
    Preparation *work = &self->work;
    if (self->proven && self->level == LEVEL_MAP) {
        keep_as_good(self, augmentations);
    }
    for (int channel = 0; channel < 2; channel++) {
        if (work->changes[channel]) {
            adaptive_commit(&augmentations[channel].adaptive, preparation_features(work, channel),
                            work->plans + channel);
        }
    }
    self->version = version;
    memcpy(self->content, work->content, sizeof self->content);
    self->proven = false;
    self->needs_evidence = self->losses >= self->config.losses_max;
    bool at_once = self->adapting && self->level == LEVEL_MAP && !self->needs_evidence;
    enter(self, at_once || !self->config.watch.enabled ? LEVEL_MAP : LEVEL_BIAS);
}

/* Guard._conclude: false if the version before was taken back, and the preparation starts again */
static bool conclude(Guard *self, Augmentation *augmentations, const FeatureSet *features, Refusal *refusal) {
    *refusal = preparation_plans(&self->work, features, augmentations, self->tests);
    if (*refusal != REFUSAL_NONE) {
        return true;
    }
    real jump = preparation_jump(&self->work, augmentations);
    if (too_often(self, jump)) {
        *refusal = REFUSAL_SWAP_RATE;
    } else if (!(self->work.changes[0] || self->work.changes[1])) {
        renumber(self, features->version);
    } else if (self->config.watch.enabled && self->level == LEVEL_MAP && !self->proven && loses(self)) {
        self->losses++;
        take_back(self, augmentations, (Fall){.reason = FALL_BEFORE});
        return false;
    } else {
        commit(self, augmentations, features->version);
        note_swap(self, jump);
    }
    return true;
}

/* Guard.begin, Guard.cancel */
void guard_begin(Guard *self) {
    self->work.active = false;
}

/* Guard.advance */
bool guard_advance(Guard *self, Augmentation *augmentations, const FeatureSet *features, Refusal *refusal) {
    Preparation *work = &self->work;
    bool over = false;
    *refusal = REFUSAL_NONE;
    if (!work->active || work->replaces != self->version ||
        memcmp(work->replaces_content, self->content, sizeof self->content) != 0) {
        feature_content(features, work->content);
        *refusal = unwanted(self, features, work->content);
        over = *refusal != REFUSAL_NONE;
        work->active = true;
        work->replaces = self->version;
        memcpy(work->replaces_content, self->content, sizeof self->content);
        if (!over) {
            preparation_begin(work, features, augmentations, self->learns, self->config.test.enabled);
        }
    } else if (preparation_step(work, augmentations, self->tests)) {
        *refusal = work->refusal;
        over = *refusal != REFUSAL_NONE || conclude(self, augmentations, features, refusal);
    }
    work->active = work->active && !over;
    return over;
}

/* Guard.offer */
Refusal guard_offer(Guard *self, Augmentation *augmentations, const FeatureSet *features) {
    Refusal refusal;
    guard_begin(self);
    while (!guard_advance(self, augmentations, features, &refusal)) {
    }
    return refusal;
}
