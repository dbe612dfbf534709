#include "numerics/block.h"

#include <math.h>
#include <string.h>

/* Of float. */
#define MANTISSA_BITS 23
#define EXPONENT_MOST 255
#define EXPONENT_BIAS 127
/* The largest number is at least 2^(EXPONENT_LEAST - 127), so that the unit is a normal number. */
#define EXPONENT_LEAST 28

static uint32_t bits_of(real x) {
    float single = (float)x;
    uint32_t bits;
    memcpy(&bits, &single, sizeof bits);
    return bits;
}

real block_of(const real *x, int32_t count, int32_t stride, int32_t *numbers) {
    uint32_t most = 0;
    for (int32_t i = 0; i < count; i++) {
        uint32_t size = bits_of(x[i * stride]) & UINT32_C(0x7fffffff);
        most = size > most ? size : most;
    }
    int32_t exponent = (int32_t)(most >> MANTISSA_BITS);
    if (exponent == EXPONENT_MOST) {
        memset(numbers, 0, (size_t)count * sizeof *numbers);
        return REAL(NAN);
    }
    exponent = exponent < EXPONENT_LEAST ? EXPONENT_LEAST : exponent;
    for (int32_t i = 0; i < count; i++) {
        uint32_t bits = bits_of(x[i * stride]);
        int32_t down = exponent - (int32_t)(bits >> MANTISSA_BITS & UINT32_C(0xff));
        uint32_t size = (bits & UINT32_C(0x7fffff)) | UINT32_C(0x800000);
        int32_t number = down <= BLOCK_BITS ? (int32_t)(size << (BLOCK_BITS - MANTISSA_BITS - 1) >> down) : 0;
        numbers[i] = bits >> 31 ? -number : number;
    }
    uint32_t unit_bits = (uint32_t)(exponent + 1 - BLOCK_BITS) << MANTISSA_BITS;
    float unit;
    memcpy(&unit, &unit_bits, sizeof unit);
    return (real)unit;
}

int32_t nearest_whole(real x, int32_t bits) {
    uint32_t raw = bits_of(x), size = (raw & UINT32_C(0x7fffff)) | UINT32_C(0x800000);
    int32_t exponent = (int32_t)(raw >> MANTISSA_BITS & UINT32_C(0xff));
    int32_t down = EXPONENT_BIAS + MANTISSA_BITS - exponent - bits, whole = INT32_MAX;
    if (down > MANTISSA_BITS + 1 || exponent == 0) {
        whole = 0;
    } else if (down > 0) {
        whole = (int32_t)((size + (UINT32_C(1) << (down - 1))) >> down);
    } else if (down > MANTISSA_BITS - 30 && exponent != EXPONENT_MOST) {
        whole = (int32_t)(size << -down);
    }
    return raw >> 31 ? -whole : whole;
}

int64_t block_dot(const int32_t *a, const int32_t *b, int32_t count) {
    int64_t sum = 0;
    for (; count >= 4; count -= 4, a += 4, b += 4) {
        sum += (int64_t)a[0] * b[0];
        sum += (int64_t)a[1] * b[1];
        sum += (int64_t)a[2] * b[2];
        sum += (int64_t)a[3] * b[3];
    }
    for (; count > 0; count--) {
        sum += (int64_t)*a++ * *b++;
    }
    return sum;
}

real block_product(const int32_t a[3], real unit_a, const int32_t b[3], real unit_b) {
    int64_t sum = (int64_t)a[0] * b[0];
    sum += (int64_t)a[1] * b[1];
    sum += (int64_t)a[2] * b[2];
    float value = (float)(int32_t)(sum >> BLOCK_BITS);
    int32_t of_a = (int32_t)(bits_of(unit_a) >> MANTISSA_BITS), of_b = (int32_t)(bits_of(unit_b) >> MANTISSA_BITS);
    if (of_a == EXPONENT_MOST || of_b == EXPONENT_MOST) {
        return REAL(NAN);
    }
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    int32_t exponent = (int32_t)(bits >> MANTISSA_BITS & UINT32_C(0xff)) + of_a + of_b - 2 * EXPONENT_BIAS + BLOCK_BITS;
    if (exponent <= 0 || bits << 1 == 0) {
        return REAL(0.0);
    }
    if (exponent >= EXPONENT_MOST) {
        return REAL(NAN);
    }
    bits = (bits & ~(UINT32_C(0xff) << MANTISSA_BITS)) | (uint32_t)exponent << MANTISSA_BITS;
    memcpy(&value, &bits, sizeof value);
    return (real)value;
}
