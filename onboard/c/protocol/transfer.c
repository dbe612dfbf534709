#include "protocol/transfer.h"

#include <string.h>

#include "protocol/feature_codec.h"

/* Pieces that a chunk adds to the digest: one more than itself, so that late ones are caught up. */
#define HASHED_A_CHUNK 2

static const uint8_t NOBODY[BLAKE2B_PERSON_BYTES] = {0};

/* FeatureReceiver.__init__ */
void receiver_init(FeatureReceiver *self) {
    memset(self, 0, sizeof *self);
}

/* FeatureReceiver.reset */
void receiver_reset(FeatureReceiver *self) {
    int64_t ignored = self->ignored;
    receiver_init(self);
    self->ignored = ignored;
}

/* FeatureReceiver._begin */
static void begin(FeatureReceiver *self, const FeatureChunk *chunk) {
    self->transfer_version = chunk->version;
    memcpy(self->digest, chunk->digest, sizeof self->digest);
    self->count = chunk->count;
    self->received = 0;
    self->hashed = 0;
    blake2b_start(&self->hash, DIGEST_BYTES, NULL, 0, NOBODY);
}

/* Add the next pieces to the digest, as far as they have come: at most so many, so that no chunk has to wait for all. */
static void hash_pieces(FeatureReceiver *self, int32_t most) {
    for (; most > 0 && self->hashed < self->count && (self->received >> self->hashed & 1) != 0; most--) {
        int32_t i = self->hashed++;
        blake2b_add(&self->hash, self->pieces + i * CHUNK_DATA_MAX_BYTES, (size_t)self->sizes[i]);
    }
}

/* Push the pieces together; returns the number of bytes. */
static size_t join(FeatureReceiver *self) {
    size_t total = 0;
    for (int32_t i = 0; i < self->count; i++) {
        size_t size = (size_t)self->sizes[i];
        memmove(self->pieces + total, self->pieces + i * CHUNK_DATA_MAX_BYTES, size);
        total += size;
    }
    return total;
}

/* FeatureReceiver._verified */
static Refusal verified(FeatureReceiver *self, FeatureSet *complete) {
    uint8_t digest[DIGEST_BYTES];
    hash_pieces(self, self->count);
    blake2b_finish(&self->hash, digest);
    if (memcmp(digest, self->digest, sizeof digest) != 0) {
        return REFUSAL_DIGEST;
    }
    size_t size = join(self);
    return decode_feature_set(self->pieces, size, self->transfer_version, complete);
}

/* FeatureReceiver.receive */
bool receiver_receive(FeatureReceiver *self, const FeatureChunk *chunk, FeatureSet *complete) {
    if (chunk->version > self->transfer_version) {
        begin(self, chunk);
    }
    uint64_t bit = UINT64_C(1) << chunk->index;
    bool fits = chunk->version == self->transfer_version && chunk->count == self->count &&
                memcmp(chunk->digest, self->digest, sizeof self->digest) == 0;
    if (!fits || (self->received & bit) != 0) {
        self->ignored++;
        return false;
    }
    memcpy(self->pieces + chunk->index * CHUNK_DATA_MAX_BYTES, chunk->data, (size_t)chunk->size);
    self->sizes[chunk->index] = chunk->size;
    self->received |= bit;
    if (self->received != UINT64_MAX >> (64 - self->count)) {
        hash_pieces(self, HASHED_A_CHUNK);
        return false;
    }
    Refusal refusal = verified(self, complete);
    if (refusal != REFUSAL_NONE) {
        self->refused_version = self->transfer_version;
        self->refusal = refusal;
    }
    return refusal == REFUSAL_NONE;
}

/* FeatureReceiver.received_chunks */
int32_t receiver_received_chunks(const FeatureReceiver *self, uint8_t *bitmap) {
    int32_t bytes = (self->count + 7) / 8;
    for (int32_t i = 0; i < bytes; i++) {
        bitmap[i] = (uint8_t)(self->received >> 8 * i & 255);
    }
    return bytes;
}
