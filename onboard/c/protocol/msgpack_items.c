#include "protocol/msgpack_items.h"

void msgpack_start(MsgpackReader *self, const uint8_t *data, size_t size, uint64_t array_max, uint64_t text_max) {
    *self = (MsgpackReader){data, data + size, array_max, text_max};
}

static bool has(const MsgpackReader *self, uint64_t count) {
    return (uint64_t)(self->end - self->at) >= count;
}

/* A number of 1, 2, 4 or 8 bytes, the most significant first; false if the bytes end before. */
static bool read_number(MsgpackReader *self, int size, uint64_t *value) {
    *value = 0;
    if (!has(self, (uint64_t)size)) {
        return false;
    }
    for (int i = 0; i < size; i++) {
        *value = *value << 8 | *self->at++;
    }
    return true;
}

/* The bytes of a text, or of bytes, of that length. */
static bool take_bytes(MsgpackReader *self, MsgpackItem *item, MsgpackKind kind, uint64_t length) {
    if (!has(self, length)) {
        return false;
    }
    item->kind = kind;
    item->number = length;
    item->bytes = self->at;
    self->at += length;
    return true;
}

/* Bytes that continue a character of UTF-8, by its first byte; -1 for a byte that begins none. `least`: the least value of
 * the second byte, `most` the largest: overlong forms, surrogates and values above 0x10ffff are excluded. */
static int continued(uint8_t first, uint8_t *least, uint8_t *most) {
    *least = first == 0xe0 ? 0xa0 : first == 0xf0 ? 0x90 : 0x80;
    *most = first == 0xed ? 0x9f : first == 0xf4 ? 0x8f : 0xbf;
    if (first < 0x80) {
        return 0;
    }
    if (first < 0xc2 || first > 0xf4) {
        return -1;
    }
    return first < 0xe0 ? 1 : first < 0xf0 ? 2 : 3;
}

static bool is_utf8(const uint8_t *bytes, uint64_t count) {
    uint64_t i = 0;
    while (i < count) {
        uint8_t least, most;
        int more = continued(bytes[i++], &least, &most);
        if (more < 0 || count - i < (uint64_t)more) {
            return false;
        }
        for (int k = 0; k < more; k++, i++) {
            if (bytes[i] < (k == 0 ? least : 0x80) || bytes[i] > (k == 0 ? most : 0xbf)) {
                return false;
            }
        }
    }
    return true;
}

static bool take_text(MsgpackReader *self, MsgpackItem *item, uint64_t length) {
    return length <= self->text_max && take_bytes(self, item, MSGPACK_TEXT, length) && is_utf8(item->bytes, length);
}

static bool take_array(const MsgpackReader *self, MsgpackItem *item, uint64_t count) {
    item->kind = MSGPACK_ARRAY;
    item->number = count;
    return count <= self->array_max;
}

/* An integer of `size` bytes. */
static bool take_integer(MsgpackReader *self, MsgpackItem *item, int size, bool is_signed) {
    item->kind = MSGPACK_INTEGER;
    bool complete = read_number(self, size, &item->number);
    item->negative = is_signed && (item->number >> (8 * size - 1) & 1) == 1;
    if (item->negative && size < 8) {
        item->number |= UINT64_MAX << 8 * size;
    }
    return complete;
}

/* A float or a value that no field of the protocol has: it is passed over. */
static bool pass(MsgpackReader *self, uint64_t size) {
    if (!has(self, size)) {
        return false;
    }
    self->at += size;
    return true;
}

/* An extension without data. Type -1 is a time, which has some. */
static bool take_empty_extension(MsgpackReader *self, uint64_t length) {
    return length == 0 && has(self, 1) && *self->at++ != 0xff;
}

/* An item of the kinds from 0xc0 on, those with one byte apart. */
static bool take_long(MsgpackReader *self, MsgpackItem *item, uint8_t head) {
    static const int width[3] = {1, 2, 4};
    uint64_t length;
    if (head >= 0xc4 && head <= 0xc6) {
        return read_number(self, width[head - 0xc4], &length) && take_bytes(self, item, MSGPACK_BYTES, length);
    }
    if (head >= 0xc7 && head <= 0xc9) {
        return read_number(self, width[head - 0xc7], &length) && take_empty_extension(self, length);
    }
    if (head == 0xca || head == 0xcb) {
        return pass(self, head == 0xca ? 4 : 8);
    }
    if (head >= 0xcc && head <= 0xd3) {
        return take_integer(self, item, 1 << (head & 3), head >= 0xd0);
    }
    if (head >= 0xd9 && head <= 0xdb) {
        return read_number(self, width[head - 0xd9], &length) && take_text(self, item, length);
    }
    if (head == 0xdc || head == 0xdd) {
        return read_number(self, head == 0xdc ? 2 : 4, &length) && take_array(self, item, length);
    }
    if (head == 0xde || head == 0xdf) {
        return read_number(self, head == 0xde ? 2 : 4, &length) && length == 0;
    }
    return head == 0xc2 || head == 0xc3; /* false and true; the rest has data of a fixed size, or does not exist */
}

bool msgpack_next(MsgpackReader *self, MsgpackItem *item) {
    *item = (MsgpackItem){.kind = MSGPACK_OTHER};
    bool good = false;
    if (has(self, 1)) {
        uint8_t head = *self->at++;
        if (head < 0x80 || head >= 0xe0) {
            item->kind = MSGPACK_INTEGER;
            item->negative = head >= 0xe0;
            item->number = item->negative ? UINT64_MAX << 8 | head : head;
            good = true;
        } else if (head < 0x90) {
            good = head == 0x80;
        } else if (head < 0xa0) {
            good = take_array(self, item, head & 15);
        } else if (head < 0xc0) {
            good = take_text(self, item, head & 31);
        } else if (head == 0xc0) {
            item->kind = MSGPACK_NIL;
            good = true;
        } else {
            good = take_long(self, item, head);
        }
    }
    if (!good) {
        item->kind = MSGPACK_OTHER;
    }
    return good;
}

bool msgpack_skip(MsgpackReader *self, uint64_t count) {
    while (count > 0) {
        MsgpackItem item;
        if (!msgpack_next(self, &item)) {
            return false;
        }
        count += item.kind == MSGPACK_ARRAY ? item.number : 0;
        count--;
    }
    return true;
}

bool msgpack_is_one_item(const MsgpackReader *self) {
    MsgpackReader reader = *self;
    return msgpack_skip(&reader, 1) && reader.at == reader.end;
}
