#include "estimation/stuck_gyro.h"

#include <string.h>

#include "protocol/geometry.h"

/* StuckGyro.__init__ */
void stuck_gyro_init(StuckGyro *self, int32_t samples, real disturbance_filter_s) {
    memset(self, 0, sizeof *self);
    self->needed = samples;
    self->filter_s = disturbance_filter_s;
    self->runs[0] = self->runs[1] = self->runs[2] = 1;
}

/* self.axes */
bool stuck_gyro_any(const StuckGyro *self) {
    return self->stuck[0] || self->stuck[1] || self->stuck[2];
}

/* StuckGyro.reset */
void stuck_gyro_reset(StuckGyro *self) {
    self->biases_count = 0;
    memset(self->stuck, 0, sizeof self->stuck);
}

/* StuckGyro.expect. The rate of an axis that was just found jumps to the new one, which is no disturbance. */
void stuck_gyro_expect(StuckGyro *self, const real u_hat[3], const real residual[3], real dt) {
    real share = dt / (self->filter_s + dt);
    vector_copy(u_hat, self->u_hat);
    for (int i = 0; i < 3; i++) {
        real d = self->disturbance[i], r = self->found[i] ? d : residual[i];
        self->disturbance[i] = d + share * (r - d);
        self->found[i] = false;
    }
}

/* The sample `index` places after the oldest that is kept. */
static const GyroSample *sample_at(const StuckGyro *self, int32_t index) {
    return self->samples + (self->samples_first + index) % GYRO_KEPT;
}

/* self._samples.append */
static void keep_sample(StuckGyro *self, const real rates[3], real dt) {
    GyroSample *sample = self->samples + (self->samples_first + self->samples_count) % GYRO_KEPT;
    if (self->samples_count == GYRO_KEPT) {
        self->samples_first = (self->samples_first + 1) % GYRO_KEPT;
    } else {
        self->samples_count++;
    }
    vector_copy(rates, sample->rates);
    sample->dt = dt;
    vector_copy(self->u_hat, sample->u_hat);
    vector_copy(self->disturbance, sample->disturbance);
}

/* StuckGyro._limit: the run that means stuck, samples; 0: none does */
static int32_t limit_of(const StuckGyro *self, int axis) {
    if (self->stuck[axis] || self->samples_count < GYRO_KEPT) {
        return 0;
    }
    int32_t repeats = 0;
    for (int32_t i = 1; i < GYRO_KEPT - self->needed; i++) {
        repeats += sample_at(self, i)->rates[axis] == sample_at(self, i - 1)->rates[axis];
    }
    return repeats <= REPEATS_ALLOWED ? self->needed + PER_REPEAT * repeats : 0;
}

/* StuckGyro._replace: begin with the last rate before the run, and add the motors' turn since then */
static real replace(StuckGyro *self, int axis) {
    int32_t first = self->samples_count - self->runs[axis] - 1;
    const GyroSample *before = sample_at(self, first < 0 ? 0 : first);
    real rate = before->rates[axis], turn = REAL(0.0), disturbance = before->disturbance[axis];
    for (int32_t i = (first < 0 ? 0 : first) + 1; i < self->samples_count; i++) {
        const GyroSample *sample = sample_at(self, i);
        rate += (sample->u_hat[axis] + disturbance) * sample->dt;
        turn += (rate - sample->rates[axis]) * sample->dt;
    }
    self->disturbance[axis] = disturbance;
    self->rates[axis] = rate;
    self->stuck[axis] = true;
    self->found[axis] = true;
    return turn;
}

/* StuckGyro._judge: count the samples in a row that are equal */
static void judge(StuckGyro *self, const real rates[3], const real accelerometer[3], FoundAxes *found) {
    bool all_equal = true;
    for (int i = 0; i < 3; i++) {
        all_equal = all_equal && rates[i] == self->last_rates[i] && accelerometer[i] == self->last_accelerometer[i];
    }
    for (int axis = 0; axis < 3; axis++) {
        if (all_equal || rates[axis] != self->last_rates[axis]) { /* the whole IMU repeats: its link judges that */
            self->runs[axis] = 1;
            continue;
        }
        self->runs[axis]++;
        if (self->runs[axis] == self->needed) {
            self->limits[axis] = limit_of(self, axis);
        }
        if (self->runs[axis] == self->limits[axis]) {
            found->turn_rad[found->count] = replace(self, axis);
            found->axis[found->count++] = axis;
        }
    }
}

/* StuckGyro.receive */
void stuck_gyro_receive(StuckGyro *self, const real rates[3], const real accelerometer[3], real dt, bool flying,
                        FoundAxes *found) {
    bool repeats = false;
    found->count = 0;
    keep_sample(self, rates, dt);
    for (int axis = 0; axis < 3; axis++) {
        if (self->stuck[axis]) {
            self->rates[axis] += (self->u_hat[axis] + self->disturbance[axis]) * dt;
        }
        repeats = repeats || rates[axis] == self->last_rates[axis];
    }
    if (flying && repeats) {
        judge(self, rates, accelerometer, found);
    } else {
        self->runs[0] = self->runs[1] = self->runs[2] = 1;
    }
    vector_copy(rates, self->last_rates);
    vector_copy(accelerometer, self->last_accelerometer);
}

/* StuckGyro.replaced */
void stuck_gyro_replaced(const StuckGyro *self, const real rates[3], real out[3]) {
    for (int axis = 0; axis < 3; axis++) {
        out[axis] = self->stuck[axis] ? self->rates[axis] : rates[axis];
    }
}

/* StuckGyro.note_bias */
void stuck_gyro_note_bias(StuckGyro *self, const real bias[3], int64_t time_ns, real dt) {
    GyroBias *noted = self->biases + (self->biases_first + self->biases_count) % GYRO_KEPT;
    if (self->biases_count == GYRO_KEPT) {
        self->biases_first = (self->biases_first + 1) % GYRO_KEPT;
    } else {
        self->biases_count++;
    }
    noted->dt = dt;
    noted->time_ns = time_ns;
    vector_copy(bias, noted->bias);
}

/* StuckGyro.turn_since */
void stuck_gyro_turn_since(const StuckGyro *self, int64_t time_ns, const real bias[3], real turn[3]) {
    vector_zero(turn);
    for (int32_t i = self->biases_count - 1; i >= 0; i--) {
        const GyroBias *noted = self->biases + (self->biases_first + i) % GYRO_KEPT;
        if (noted->time_ns <= time_ns) {
            break;
        }
        for (int axis = 0; axis < 3; axis++) {
            turn[axis] += (noted->bias[axis] - bias[axis]) * noted->dt;
        }
    }
}
