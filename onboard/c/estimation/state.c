#include "estimation/state.h"

#include <string.h>

#include "estimation/error_state_filter.h"
#include "estimation/readings.h"
#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* VehicleState */
void state_init(VehicleState *self) {
    memset(self, 0, sizeof *self);
    self->quaternion[0] = REAL(1.0);
    self->rotation[0] = self->rotation[4] = self->rotation[8] = REAL(1.0);
    self->last_imu_ns = self->last_pose_ns = self->last_velocity_aid_ns = self->last_height_ns = NEVER_NS;
}

/* VehicleState.publish */
void state_publish(VehicleState *self, const ErrorStateFilter *source, const ImuReading *reading) {
    self->time_ns = reading->time_ns;
    vector_copy(source->position, self->position);
    vector_copy(source->velocity, self->velocity);
    vector_copy(source->gyro_bias, self->gyro_bias);
    vector_subtract(reading->gyroscope, source->gyro_bias, self->rates);
    vector_copy(source->accelerometer_bias, self->accelerometer_bias);
    vector_subtract(reading->accelerometer, source->accelerometer_bias, self->specific_force);
    state_publish_attitude(self, source);
}

/* VehicleState.publish_attitude */
void state_publish_attitude(VehicleState *self, const ErrorStateFilter *source) {
    memcpy(self->quaternion, source->quaternion, sizeof self->quaternion);
    memcpy(self->rotation, source->rotation, sizeof self->rotation);
    euler_of(self->rotation, self->euler);
    self->tilt_rad = tilt_angle(self->rotation[8]);
}

/* VehicleState.publish_sigmas */
void state_publish_sigmas(VehicleState *self, const ErrorStateFilter *source) {
    real variance[6];
    for (int i = 0; i < 6; i++) {
        variance[i] = source->P[i * (ERROR_SIZE + 1)];
    }
    real velocity = real_max(real_max(variance[3], variance[4]), variance[5]);
    self->position_sigma_m = real_sqrt(real_max(real_max(variance[0], variance[1]), REAL(0.0)));
    self->velocity_sigma_m_s = real_sqrt(real_max(velocity, REAL(0.0)));
}
