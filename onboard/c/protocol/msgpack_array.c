#include "protocol/msgpack_array.h"

#include <string.h>

#include "protocol/little_endian.h"
#include "protocol/msgpack_items.h"

/* First bytes (the msgpack specification). */
enum { FIXED_ARRAY = 0x90, BIN_8 = 0xc4, BIN_16 = 0xc5, UINT_8 = 0xcc, UINT_16 = 0xcd, UINT_32 = 0xce, UINT_64 = 0xcf };

/* --- reading --- */

/* The integer of an item; INT64_MIN if it is above 2^63 - 1 */
static int64_t integer_of(const MsgpackItem *item) {
    if (item->negative) {
        return -(int64_t)(UINT64_MAX - item->number) - 1;
    }
    return item->number <= INT64_MAX ? (int64_t)item->number : INT64_MIN;
}

/* The next field, a number ("i") or bytes ("b") */
static bool read_field(MsgpackReader *reader, char kind, int32_t bytes_max, MsgpackField *field) {
    MsgpackItem item;
    if (!msgpack_next(reader, &item) || item.kind != (kind == 'i' ? MSGPACK_INTEGER : MSGPACK_BYTES)) {
        return false;
    }
    if (kind == 'i') {
        field->number = integer_of(&item);
        return true;
    }
    field->bytes = item.bytes;
    field->size = item.number <= (uint64_t)bytes_max ? (int32_t)item.number : 0;
    return item.number <= (uint64_t)bytes_max;
}

bool msgpack_read(const uint8_t *data, size_t size, const char *kinds, int32_t bytes_max, MsgpackField *fields) {
    MsgpackReader reader;
    MsgpackItem array;
    uint64_t i = 0;
    msgpack_start(&reader, data, size, UINT64_MAX, 0);
    if (!msgpack_next(&reader, &array) || array.kind != MSGPACK_ARRAY) {
        return false;
    }
    for (; i < array.number && kinds[i] != '\0'; i++) {
        if (!read_field(&reader, kinds[i], bytes_max, fields + i)) {
            return false;
        }
    }
    return i == array.number && kinds[i] == '\0' && reader.at == reader.end;
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
