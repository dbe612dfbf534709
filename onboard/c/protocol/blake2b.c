#include "protocol/blake2b.h"

#include <stdbool.h>
#include <string.h>

#include "protocol/little_endian.h"

#define ROUNDS 12

static const uint64_t INITIAL[8] = {UINT64_C(0x6a09e667f3bcc908), UINT64_C(0xbb67ae8584caa73b),
                                    UINT64_C(0x3c6ef372fe94f82b), UINT64_C(0xa54ff53a5f1d36f1),
                                    UINT64_C(0x510e527fade682d1), UINT64_C(0x9b05688c2b3e6c1f),
                                    UINT64_C(0x1f83d9abfb41bd6b), UINT64_C(0x5be0cd19137e2179)};

static uint64_t turned_right(uint64_t word, int bits) {
    return word >> bits | word << (64 - bits);
}

/* RFC 7693, 3.1: G, on the words at i, j, k and l of v */
static void mix(uint64_t v[16], int i, int j, int k, int l, uint64_t x, uint64_t y) {
    uint64_t a = v[i], b = v[j], c = v[k], d = v[l];
    a += b + x;
    d = turned_right(d ^ a, 32);
    c += d;
    b = turned_right(b ^ c, 24);
    a += b + y;
    d = turned_right(d ^ a, 16);
    c += d;
    b = turned_right(b ^ c, 63);
    v[i] = a;
    v[j] = b;
    v[k] = c;
    v[l] = d;
}

/* One round with the schedule `s`: columns, then diagonals */
static void mix_round(uint64_t v[16], const uint64_t m[16], const uint8_t s[16]) {
    mix(v, 0, 4, 8, 12, m[s[0]], m[s[1]]);
    mix(v, 1, 5, 9, 13, m[s[2]], m[s[3]]);
    mix(v, 2, 6, 10, 14, m[s[4]], m[s[5]]);
    mix(v, 3, 7, 11, 15, m[s[6]], m[s[7]]);
    mix(v, 0, 5, 10, 15, m[s[8]], m[s[9]]);
    mix(v, 1, 6, 11, 12, m[s[10]], m[s[11]]);
    mix(v, 2, 7, 8, 13, m[s[12]], m[s[13]]);
    mix(v, 3, 4, 9, 14, m[s[14]], m[s[15]]);
}

/* RFC 7693, 3.2: F. The block holds `size` bytes that count; the rest of it is zero. */
static void compress(Blake2b *self, int32_t size, bool last) {
    static const uint8_t schedule[10][16] = {
        {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}, {14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3},
        {11, 8, 12, 0, 5, 2, 15, 13, 10, 14, 3, 6, 7, 1, 9, 4}, {7, 9, 3, 1, 13, 12, 11, 14, 2, 6, 5, 10, 4, 0, 15, 8},
        {9, 0, 5, 7, 2, 4, 10, 15, 14, 1, 11, 12, 6, 8, 3, 13}, {2, 12, 6, 10, 0, 11, 8, 3, 4, 13, 7, 5, 15, 14, 1, 9},
        {12, 5, 1, 15, 14, 13, 4, 10, 0, 7, 6, 3, 9, 2, 8, 11}, {13, 11, 7, 14, 12, 1, 3, 9, 5, 0, 15, 4, 8, 6, 2, 10},
        {6, 15, 14, 9, 11, 3, 0, 8, 12, 2, 13, 7, 1, 4, 10, 5}, {10, 2, 8, 4, 7, 6, 1, 5, 15, 11, 9, 14, 3, 12, 13, 0}};
    uint64_t v[16], m[16];
    self->compressed[0] += (uint64_t)size;
    self->compressed[1] += self->compressed[0] < (uint64_t)size;
    memcpy(v, self->chain, sizeof self->chain);
    memcpy(v + 8, INITIAL, sizeof INITIAL);
    v[12] ^= self->compressed[0];
    v[13] ^= self->compressed[1];
    if (last) {
        v[14] = ~v[14];
    }
    for (int i = 0; i < 16; i++) {
        m[i] = read_u64(self->block + 8 * i);
    }
    for (int i = 0; i < ROUNDS; i++) {
        mix_round(v, m, schedule[i % 10]);
    }
    for (int i = 0; i < 8; i++) {
        self->chain[i] ^= v[i] ^ v[i + 8];
    }
}

void blake2b_start(Blake2b *self, int32_t digest_size, const uint8_t *key, int32_t key_size,
                   const uint8_t person[BLAKE2B_PERSON_BYTES]) {
    memset(self, 0, sizeof *self);
    memcpy(self->chain, INITIAL, sizeof INITIAL);
    self->digest_size = digest_size;
    /* The parameter block: digest and key size, fanout 1 and depth 1; no salt; the personalisation at the end. */
    self->chain[0] ^= UINT64_C(0x01010000) ^ (uint64_t)key_size << 8 ^ (uint64_t)digest_size;
    self->chain[6] ^= read_u64(person);
    self->chain[7] ^= read_u64(person + 8);
    if (key_size > 0) { /* the key is a block of its own before the input */
        memcpy(self->block, key, (size_t)key_size);
        self->block_size = BLAKE2B_BLOCK_BYTES;
    }
}

void blake2b_add(Blake2b *self, const uint8_t *data, size_t size) {
    while (size > 0) {
        if (self->block_size == BLAKE2B_BLOCK_BYTES) { /* not before there is more: the last block is special */
            compress(self, BLAKE2B_BLOCK_BYTES, false);
            self->block_size = 0;
        }
        size_t room = (size_t)(BLAKE2B_BLOCK_BYTES - self->block_size), part = size < room ? size : room;
        memcpy(self->block + self->block_size, data, part);
        self->block_size += (int32_t)part;
        data += part;
        size -= part;
    }
}

void blake2b_finish(Blake2b *self, uint8_t *digest) {
    uint8_t all[BLAKE2B_DIGEST_MAX];
    memset(self->block + self->block_size, 0, (size_t)(BLAKE2B_BLOCK_BYTES - self->block_size));
    compress(self, self->block_size, true);
    for (int i = 0; i < 8; i++) {
        write_u64(all + 8 * i, self->chain[i]);
    }
    memcpy(digest, all, (size_t)self->digest_size);
}
