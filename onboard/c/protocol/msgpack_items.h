/* Reads msgpack item by item, within the limits of the protocol: no maps and no extensions but empty ones. The only
 * reader: of feature sets and, by msgpack_array.h, of messages. */
#ifndef DMRAC_MSGPACK_ITEMS_H
#define DMRAC_MSGPACK_ITEMS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef enum { MSGPACK_NIL, MSGPACK_INTEGER, MSGPACK_BYTES, MSGPACK_TEXT, MSGPACK_ARRAY, MSGPACK_OTHER } MsgpackKind;

/* An item; the items of an array follow it. */
typedef struct {
    MsgpackKind kind;
    bool negative;        /* of an integer */
    uint64_t number;      /* the integer, a negative one as two's complement of 64 bits; bytes, or items of an array */
    const uint8_t *bytes; /* of bytes and text */
} MsgpackItem;

typedef struct {
    const uint8_t *at;
    const uint8_t *end;
    uint64_t array_max; /* items */
    uint64_t text_max;  /* bytes */
} MsgpackReader;

void msgpack_start(MsgpackReader *self, const uint8_t *data, size_t size, uint64_t array_max, uint64_t text_max);

/* The next item; false if the bytes end before it does or it is not within the limits, and it is MSGPACK_OTHER then. */
bool msgpack_next(MsgpackReader *self, MsgpackItem *item);

/* Skip so many items, with all within them. False as above. */
bool msgpack_skip(MsgpackReader *self, uint64_t count);

/* Whether what is left is one item, within the limits, and nothing else. */
bool msgpack_is_one_item(const MsgpackReader *self);

#endif
