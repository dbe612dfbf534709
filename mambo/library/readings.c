#include "readings.h"

#include <string.h>

#include "generated/constants.h"
#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* Share of the difference between call and even clock that the clock takes up in a call. */
#define CLOCK_SHARE REAL(0.02)
/* Beyond it the clock starts again, in periods. */
#define CLOCK_SLIP_PERIODS 2
#define BATTERY_PERIOD_NS INT64_C(1000000000)
#define BATTERY_MAX_V REAL(60.0)
#define FLOW_S_MIN REAL(0.001)
#define FLOW_S_MAX REAL(0.5)
#define FLOW_SPEED_MAX_M_S REAL(20.0)
#define QUALITY_SEEN 200
/* Nearer than this the flow's scale is not known. */
#define FLOW_DISTANCE_MIN_M REAL(0.05)

float acquisition_float(const uint8_t *acquisition, int32_t place, int32_t index) {
    float value;
    memcpy(&value, acquisition + place + 4 * index, sizeof value);
    return value;
}

uint32_t acquisition_u32(const uint8_t *acquisition, int32_t place) {
    uint32_t value;
    memcpy(&value, acquisition + place, sizeof value);
    return value;
}

void sensor_reader_init(SensorReader *self, const LibraryConfig *config, int64_t period_ns) {
    memset(self, 0, sizeof *self);
    self->layout = config->board.layout;
    self->sensors = config->board.sensors;
    self->limits = config->arming;
    self->period_ns = period_ns;
    self->frozen_after = config->board.watchdogs.frozen_calls;
    self->flow_ns = self->battery_ns = NEVER_NS;
}

bool sensor_reader_is_frozen(const SensorReader *self) {
    return self->repeats >= self->frozen_after;
}

/* --- IMU --- */

/* Body axis from the firmware's axes: 1 to 3 with a sign. */
static real along(const real v[3], int32_t axis) {
    return axis > 0 ? v[axis - 1] : -v[-axis - 1];
}

/* The mean of the samples of one sensor, in the firmware's axes and units. */
static void mean_of(const SensorReader *self, const uint8_t *acquisition, int32_t single, int32_t fifo, real out[3]) {
    bool several = self->sensors.imu == BOARD_SENSORS_IMU_FIFO;
    int32_t samples = several ? FIFO_SAMPLES : 1;
    vector_zero(out);
    for (int32_t i = 0; i < samples; i++) {
        for (int32_t j = 0; j < 3; j++) {
            out[j] += acquisition_float(acquisition, several ? fifo : single, 3 * i + j);
        }
    }
    vector_scale(out, REAL(1.0) / (real)samples, out);
}

static void to_body(const real raw[3], const int32_t axes[3], real scale, real out[3]) {
    for (int32_t i = 0; i < 3; i++) {
        out[i] = scale * along(raw, axes[i]);
    }
}

static bool is_within(const real v[3], real limit) {
    for (int32_t i = 0; i < 3; i++) {
        if (!(v[i] >= -limit && v[i] <= limit)) { /* also catches NaN */
            return false;
        }
    }
    return true;
}

/* Whether the IMU has changed since the last call. */
static bool is_new(SensorReader *self, const uint8_t *acquisition) {
    const BoardLayout *layout = &self->layout;
    bool several = self->sensors.imu == BOARD_SENSORS_IMU_FIFO;
    size_t size = several ? FIFO_SAMPLES * 12 : 12;
    uint8_t present[sizeof self->latest] = {0};
    memcpy(present, acquisition + (several ? layout->fifo_accelerometer : layout->accelerometer), size);
    memcpy(present + size, acquisition + (several ? layout->fifo_gyroscope : layout->gyroscope), size);
    bool same = self->started && memcmp(present, self->latest, sizeof present) == 0;
    memcpy(self->latest, present, sizeof present);
    self->repeats = same ? self->repeats + 1 : 0;
    return !same;
}

/* The even clock's time of this call's samples. */
static int64_t sample_time(SensorReader *self, int64_t now_ns) {
    int64_t expected = self->sample_ns + self->period_ns;
    int64_t off = now_ns - expected;
    if (!self->started || off > CLOCK_SLIP_PERIODS * self->period_ns || off < -CLOCK_SLIP_PERIODS * self->period_ns) {
        return now_ns;
    }
    int64_t time_ns = expected + (int64_t)(CLOCK_SHARE * (real)off);
    return time_ns < now_ns ? time_ns : now_ns;
}

static void read_imu(SensorReader *self, const uint8_t *acquisition, int64_t now_ns, Readings *out) {
    real raw[3];
    if (!is_new(self, acquisition)) {
        return;
    }
    int64_t time_ns = sample_time(self, now_ns);
    real dt = self->started ? (real)((double)(time_ns - self->sample_ns) * 1e-9) : REAL(0.0);
    self->sample_ns = time_ns;
    self->started = true;
    mean_of(self, acquisition, self->layout.accelerometer, self->layout.fifo_accelerometer, raw);
    to_body(raw, self->sensors.accelerometer_axes, self->sensors.accelerometer_scale, out->imu.accelerometer);
    mean_of(self, acquisition, self->layout.gyroscope, self->layout.fifo_gyroscope, raw);
    to_body(raw, self->sensors.gyroscope_axes, self->sensors.gyroscope_scale, out->imu.gyroscope);
    if (!is_within(out->imu.accelerometer, self->limits.acceleration_max_m_s2) ||
        !is_within(out->imu.gyroscope, self->limits.rate_max_rad_s)) {
        self->dropped[DROPPED_IMU]++;
        return;
    }
    out->imu.time_ns = time_ns;
    out->has_imu = true;
    self->rotation[0] += dt * out->imu.gyroscope[0];
    self->rotation[1] += dt * out->imu.gyroscope[1];
    self->rotation_s += dt;
}

/* The pressure of a sample, if it has changed. */
static void read_pressure(SensorReader *self, const uint8_t *acquisition, Readings *out) {
    float raw = acquisition_float(acquisition, self->layout.pressure, 0);
    real pressure_pa = self->sensors.pressure_scale * raw;
    bool same = memcmp(&raw, &self->pressure, sizeof raw) == 0;
    self->pressure = raw;
    if (same || !out->has_imu) {
        return;
    }
    if (!(pressure_pa >= self->limits.pressure_min_pa && pressure_pa <= self->limits.pressure_max_pa)) {
        self->dropped[DROPPED_PRESSURE]++;
        return;
    }
    out->imu.has_pressure = true;
    out->imu.pressure_pa = pressure_pa;
}

/* --- ultrasonic and battery --- */

static void read_range(SensorReader *self, const uint8_t *acquisition, int64_t now_ns, Readings *out) {
    float raw = acquisition_float(acquisition, self->layout.altitude, 0);
    real distance_m = self->sensors.altitude_scale * raw;
    bool same = memcmp(&raw, &self->altitude, sizeof raw) == 0;
    self->altitude = raw;
    if (same) {
        return;
    }
    if (!(distance_m > REAL(0.0) && distance_m <= self->limits.distance_max_m)) {
        self->dropped[DROPPED_RANGE]++;
        return;
    }
    out->range = (RangeReading){now_ns, distance_m};
    out->has_range = true;
}

static void read_battery(SensorReader *self, const uint8_t *acquisition, int64_t now_ns, Readings *out) {
    real voltage_v = acquisition_float(acquisition, self->layout.battery_voltage, 0);
    uint32_t percent = acquisition_u32(acquisition, self->layout.battery_percent);
    if (now_ns - self->battery_ns < BATTERY_PERIOD_NS) {
        return;
    }
    self->battery_ns = now_ns;
    if (!(voltage_v > REAL(0.0) && voltage_v < BATTERY_MAX_V) || percent > 100) {
        self->dropped[DROPPED_BATTERY]++;
        return;
    }
    out->battery = (BatteryReading){now_ns, voltage_v, REAL(0.01) * (real)percent};
    out->has_battery = true;
}

/* --- flow --- */

static int32_t quality_of(const BoardSensors *sensors, const FlowCall *call) {
    real quality = call->quality;
    if (!call->defined) {
        return 0;
    }
    if (sensors->flow_quality == BOARD_SENSORS_FLOW_QUALITY_DEFINED) {
        return QUALITY_SEEN;
    }
    if (!(quality >= REAL(0.0))) {
        return 0;
    }
    quality = sensors->flow_quality == BOARD_SENSORS_FLOW_QUALITY_SHARE ? REAL(255.0) * quality : quality;
    return (int32_t)real_min(quality, REAL(255.0));
}

/* The flow of one call; false if there is none to use. */
static bool read_flow(SensorReader *self, const FlowCall *call, const FlowGeometry *geometry, FlowReading *out) {
    const BoardSensors *sensors = &self->sensors;
    real raw[3] = {call->velocity[0], call->velocity[1], call->velocity[2]};
    int64_t last_ns = self->flow_ns;
    real rotation[2] = {self->rotation[0] - self->rotation_s * geometry->gyro_bias[0],
                        self->rotation[1] - self->rotation_s * geometry->gyro_bias[1]};
    real passed_s = (real)((double)(call->time_ns - last_ns) * 1e-9);
    self->flow_ns = call->time_ns;
    self->rotation[0] = self->rotation[1] = self->rotation_s = REAL(0.0);
    if (!is_within(raw, FLOW_SPEED_MAX_M_S / sensors->flow_scale)) {
        self->dropped[DROPPED_FLOW]++;
        return false;
    }
    if (last_ns == NEVER_NS || passed_s < FLOW_S_MIN || passed_s > FLOW_S_MAX || !geometry->known) {
        return false;
    }
    real share = sensors->flow_scale * passed_s / real_max(geometry->distance_m, FLOW_DISTANCE_MIN_M);
    real turned_x = sensors->flow_compensated ? rotation[0] : REAL(0.0);
    real turned_y = sensors->flow_compensated ? rotation[1] : REAL(0.0);
    *out = (FlowReading){
        .time_ns = call->time_ns,
        .integration_s = passed_s,
        .flow_x = turned_x - share * along(raw, sensors->flow_axes[1]),
        .flow_y = turned_y + share * along(raw, sensors->flow_axes[0]),
        .rotation_x = rotation[0],
        .rotation_y = rotation[1],
        .quality = quality_of(sensors, call),
    };
    return true;
}

void sensor_reader_read(SensorReader *self, const uint8_t *acquisition, const FlowCall *calls, int32_t call_count,
                        const FlowGeometry *geometry, int64_t now_ns, Readings *out) {
    memset(out, 0, sizeof *out);
    read_imu(self, acquisition, now_ns, out);
    read_pressure(self, acquisition, out);
    read_range(self, acquisition, now_ns, out);
    read_battery(self, acquisition, now_ns, out);
    for (int32_t i = 0; i < call_count; i++) {
        out->flow_count += read_flow(self, calls + i, geometry, out->flows + out->flow_count);
    }
}
