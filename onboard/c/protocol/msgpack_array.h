/* Reads and writes the only msgpack shape of a message's body: one array of whole numbers and binary fields. The twin of
 * protocol/msgpack_array.py, which reads, and of what protocol/codec.py uses of msgpack to write. */
#ifndef DMRAC_MSGPACK_ARRAY_H
#define DMRAC_MSGPACK_ARRAY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* A field that was read: a number or bytes, which lie in the body. */
typedef struct {
    int64_t number; /* INT64_MIN if it is above 2^63 - 1, which no field may be */
    const uint8_t *bytes;
    int32_t size;
} MsgpackField;

typedef struct {
    uint8_t *bytes;
    int32_t room;
    int32_t size;
    bool full; /* something did not fit */
} MsgpackWriter;

/* unpack_array and codec._typed: reads one array of as many fields as `kinds` has letters, each a number ("i") or bytes
 * ("b"), of at most `bytes_max` bytes. Every form that msgpack has for them is accepted. False for anything else. */
bool msgpack_read(const uint8_t *data, size_t size, const char *kinds, int32_t bytes_max, MsgpackField *fields);

/* The shortest form of each, as msgpack.packb writes it. Of at most 15 fields, and numbers from -32. */
void msgpack_write_array(MsgpackWriter *self, int32_t count);
void msgpack_write_number(MsgpackWriter *self, int64_t number);
void msgpack_write_bytes(MsgpackWriter *self, const uint8_t *bytes, int32_t size);
/* A binary field of float32, little-endian. */
void msgpack_write_floats(MsgpackWriter *self, const float *values, int32_t count);

#endif
