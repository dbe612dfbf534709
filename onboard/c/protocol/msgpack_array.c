#include "protocol/msgpack_array.h"

#include <string.h>

#include "protocol/little_endian.h"

/* First bytes (the msgpack specification). */
enum {
    FIXED_ARRAY = 0x90,
    BIN_8 = 0xc4,
    BIN_16 = 0xc5,
    BIN_32 = 0xc6,
    UINT_8 = 0xcc,
    UINT_16 = 0xcd,
    UINT_32 = 0xce,
    UINT_64 = 0xcf,
    INT_8 = 0xd0,
    INT_64 = 0xd3,
    ARRAY_16 = 0xdc,
    ARRAY_32 = 0xdd,
    NEGATIVE_FIXED = 0xe0
};

/* --- reading --- */

typedef struct {
    const uint8_t *at;
    size_t left;
} Cursor;

/* `count` bytes from here, as a number, most significant byte first */
static bool take_number(Cursor *from, size_t count, uint64_t *value) {
    if (from->left < count) {
        return false;
    }
    *value = 0;
    for (size_t i = 0; i < count; i++) {
        *value = *value << 8 | from->at[i];
    }
    from->at += count;
    from->left -= count;
    return true;
}

/* The head of an array: its number of fields */
static bool take_array(Cursor *from, uint64_t *count) {
    uint64_t first;
    if (!take_number(from, 1, &first)) {
        return false;
    }
    if (first >> 4 == FIXED_ARRAY >> 4) {
        *count = first & 0x0f;
        return true;
    }
    return (first == ARRAY_16 || first == ARRAY_32) && take_number(from, first == ARRAY_16 ? 2 : 4, count);
}

/* The number of two's complement in the last `count` bytes of `bits` */
static int64_t of_twos_complement(uint64_t bits, size_t count) {
    uint64_t sign = UINT64_C(1) << (8 * count - 1);
    return bits < sign ? (int64_t)bits : (int64_t)(bits - sign) - (int64_t)(sign - 1) - 1;
}

static bool take_int(Cursor *from, int64_t *number) {
    uint64_t first, bits;
    if (!take_number(from, 1, &first)) {
        return false;
    }
    if (first < 0x80 || first >= NEGATIVE_FIXED) {
        *number = of_twos_complement(first, 1);
        return true;
    }
    if (first < UINT_8 || first > INT_64) {
        return false;
    }
    size_t count = (size_t)1 << ((first - UINT_8) & 3);
    if (!take_number(from, count, &bits)) {
        return false;
    }
    if (first >= INT_8) {
        *number = of_twos_complement(bits, count);
    } else {
        *number = bits <= INT64_MAX ? (int64_t)bits : INT64_MIN;
    }
    return true;
}

static bool take_bytes(Cursor *from, int32_t most, MsgpackField *field) {
    uint64_t first, size;
    if (!take_number(from, 1, &first) || first < BIN_8 || first > BIN_32) {
        return false;
    }
    if (!take_number(from, (size_t)1 << (first - BIN_8), &size) || size > (uint64_t)most || size > from->left) {
        return false;
    }
    field->bytes = from->at;
    field->size = (int32_t)size;
    from->at += size;
    from->left -= (size_t)size;
    return true;
}

bool msgpack_read(const uint8_t *data, size_t size, const char *kinds, int32_t bytes_max, MsgpackField *fields) {
    Cursor from = {data, size};
    uint64_t count, read = 0;
    if (!take_array(&from, &count)) {
        return false;
    }
    for (; read < count && kinds[read] != '\0'; read++) {
        MsgpackField *field = fields + read;
        if (!(kinds[read] == 'i' ? take_int(&from, &field->number) : take_bytes(&from, bytes_max, field))) {
            return false;
        }
    }
    return read == count && kinds[read] == '\0' && from.left == 0;
}

/* --- writing --- */

/* The next `size` bytes; NULL if there is no room for them */
static uint8_t *next(MsgpackWriter *self, int32_t size) {
    if (self->full || size > self->room - self->size) {
        self->full = true;
        return NULL;
    }
    self->size += size;
    return self->bytes + self->size - size;
}

/* A first byte and the last `count` bytes of a number, most significant first */
static void put(MsgpackWriter *self, int32_t first, uint64_t number, int32_t count) {
    uint8_t *at = next(self, 1 + count);
    if (at != NULL) {
        at[0] = (uint8_t)first;
        for (int32_t i = count; i > 0; i--) {
            at[i] = (uint8_t)number;
            number >>= 8;
        }
    }
}

void msgpack_write_array(MsgpackWriter *self, int32_t count) {
    put(self, FIXED_ARRAY + count, 0, 0);
}

void msgpack_write_number(MsgpackWriter *self, int64_t number) {
    if (number < 0x80) { /* the negative ones as two's complement, 0xe0 to 0xff */
        put(self, (int32_t)(number & 0xff), 0, 0);
    } else if (number <= UINT8_MAX) {
        put(self, UINT_8, (uint64_t)number, 1);
    } else if (number <= UINT16_MAX) {
        put(self, UINT_16, (uint64_t)number, 2);
    } else if (number <= UINT32_MAX) {
        put(self, UINT_32, (uint64_t)number, 4);
    } else {
        put(self, UINT_64, (uint64_t)number, 8);
    }
}

static void put_bytes_head(MsgpackWriter *self, int32_t size) {
    put(self, size <= UINT8_MAX ? BIN_8 : BIN_16, (uint64_t)size, size <= UINT8_MAX ? 1 : 2);
}

void msgpack_write_bytes(MsgpackWriter *self, const uint8_t *bytes, int32_t size) {
    put_bytes_head(self, size);
    uint8_t *at = next(self, size);
    if (at != NULL) {
        memcpy(at, bytes, (size_t)size);
    }
}

void msgpack_write_floats(MsgpackWriter *self, const float *values, int32_t count) {
    put_bytes_head(self, 4 * count);
    uint8_t *at = next(self, 4 * count);
    for (int32_t i = 0; at != NULL && i < count; i++) {
        write_f32(at + 4 * i, values[i]);
    }
}
