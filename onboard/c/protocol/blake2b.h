/* BLAKE2b (RFC 7693) with a personalisation (the parameter block of Aumasson et al. 2013), of digests, keys and inputs of
 * any length that the function allows. Python has it as hashlib.blake2b. */
#ifndef DMRAC_BLAKE2B_H
#define DMRAC_BLAKE2B_H

#include <stddef.h>
#include <stdint.h>

#define BLAKE2B_BLOCK_BYTES 128
#define BLAKE2B_DIGEST_MAX 64
#define BLAKE2B_KEY_MAX 64
#define BLAKE2B_PERSON_BYTES 16

/* A hash that is being computed. A copy continues by itself. */
typedef struct {
    uint64_t chain[8];
    uint64_t compressed[2]; /* bytes, low word first */
    uint8_t block[BLAKE2B_BLOCK_BYTES];
    int32_t block_size; /* bytes that wait in the block */
    int32_t digest_size;
} Blake2b;

/* digest_size: 1 to 64. key_size: 0 (no key; `key` is not read) to 64. */
void blake2b_start(Blake2b *self, int32_t digest_size, const uint8_t *key, int32_t key_size,
                   const uint8_t person[BLAKE2B_PERSON_BYTES]);
void blake2b_add(Blake2b *self, const uint8_t *data, size_t size);
/* Writes digest_size bytes; `self` must not be used afterwards. */
void blake2b_finish(Blake2b *self, uint8_t *digest);

#endif
