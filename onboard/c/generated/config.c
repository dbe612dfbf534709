/* Written by python -m onboard.c.generate. Do not edit. */
#include "generated/config.h"

#include <string.h>

typedef struct {
    const uint8_t *at;
    bool bad; /* a count or a choice is out of its range */
} Cursor;

static uint64_t read_bits(Cursor *from) {
    uint64_t bits = 0;
    for (int i = 7; i >= 0; i--) {
        bits = bits << 8 | from->at[i];
    }
    from->at += 8;
    return bits;
}

static real read_real(Cursor *from) {
    uint64_t bits = read_bits(from);
    double value;
    memcpy(&value, &bits, sizeof value);
    return (real)value;
}

static int64_t read_int(Cursor *from) {
    uint64_t bits = read_bits(from);
    int64_t value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static void read_AirframeConfig(Cursor *from, AirframeConfig *out) {
    out->mass_kg = read_real(from);
    for (int i = 0; i < 3; i++) {
        out->inertia_kg_m2[i] = read_real(from);
    }
    out->arm_x_m = read_real(from);
    out->arm_y_m = read_real(from);
    out->yaw_torque_per_thrust_m = read_real(from);
    out->motor_thrust_max_n = read_real(from);
    out->motor_thrust_min_share = read_real(from);
    out->motor_lag_up_s = read_real(from);
    out->motor_lag_down_s = read_real(from);
    out->motor_response_s = read_real(from);
}

static void read_CoreConfig(Cursor *from, CoreConfig *out) {
    read_AirframeConfig(from, &out->airframe);
}

bool config_decode(const uint8_t *packed, size_t size, CoreConfig *out) {
    static const uint8_t header[12] = {0x44, 0x4d, 0x52, 0x43, 0xd2, 0xbb, 0xbc, 0x7c, 0x5c, 0x70, 0x9a, 0x82};
    if (size != CONFIG_IMAGE_BYTES || memcmp(packed, header, sizeof header) != 0) {
        return false;
    }
    Cursor from = {packed + sizeof header, false};
    read_CoreConfig(&from, out);
    return !from.bad;
}
