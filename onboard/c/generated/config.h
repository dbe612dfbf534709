/* Written by python -m onboard.c.generate. Do not edit. */
#ifndef DMRAC_CONFIG_H
#define DMRAC_CONFIG_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "numerics/real.h"

#define CONFIG_IMAGE_BYTES 108

/* After each member: its place within the packed record, in bytes, and its unit. */

typedef struct {
    real mass_kg; /* 0 */
    real inertia_kg_m2[3]; /* 8 */
    real arm_x_m; /* 32 */
    real arm_y_m; /* 40 */
    real yaw_torque_per_thrust_m; /* 48 */
    real motor_thrust_max_n; /* 56 */
    real motor_thrust_min_share; /* 64 */
    real motor_lag_up_s; /* 72 */
    real motor_lag_down_s; /* 80 */
    real motor_response_s; /* 88 */
} AirframeConfig;

typedef struct {
    AirframeConfig airframe; /* 0 */
} CoreConfig;

/* Reads a packed image; false if it is not one of this layout, and `out` must not be used then. */
bool config_decode(const uint8_t *packed, size_t size, CoreConfig *out);

#endif
