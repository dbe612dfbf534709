/* SHA-256 (FIPS 180-4), for the signatures of MAVLink 2. */
#ifndef DMRAC_SHA256_H
#define DMRAC_SHA256_H

#include <stddef.h>
#include <stdint.h>

#define SHA256_BYTES 32

typedef struct {
    uint32_t state[8];
    uint64_t size; /* bytes so far */
    uint8_t block[64];
} Sha256;

void sha256_start(Sha256 *self);
void sha256_add(Sha256 *self, const uint8_t *data, size_t size);
void sha256_finish(Sha256 *self, uint8_t digest[SHA256_BYTES]);

#endif
