/* From chunks to a feature set: the twin of FeatureReceiver in protocol/transfer.py. */
#ifndef DMRAC_TRANSFER_H
#define DMRAC_TRANSFER_H

#include "control/features.h"
#include "protocol/blake2b.h"
#include "protocol/messages.h"

/* Collects the chunks of the newest version. */
typedef struct {
    int64_t transfer_version; /* being received, or the last complete one; 0 for none */
    int64_t refused_version;  /* newest version refused here; 0 for none */
    Refusal refusal;
    uint8_t digest[DIGEST_BYTES];
    Blake2b hash;   /* of the pieces so far */
    int32_t hashed; /* how many they are */
    int32_t count;
    uint64_t received; /* chunk i is bit i; bits stay when the version is complete */
    int32_t sizes[CHUNK_COUNT_MAX];
    uint8_t pieces[CHUNK_COUNT_MAX * CHUNK_DATA_MAX_BYTES];
    int64_t ignored; /* unused chunks: duplicates, old versions, or at odds with the first chunk of their version */
} FeatureReceiver;

void receiver_init(FeatureReceiver *self);

/* Discard everything, as after a restart of the peer, whose version numbers may start anew. */
void receiver_reset(FeatureReceiver *self);

/* Receive a chunk that the codec has read, so that its numbers are within their limits. True if it was the last missing one
 * and the set, then in `complete`, is valid; else `complete` has not changed. */
bool receiver_receive(FeatureReceiver *self, const FeatureChunk *chunk, FeatureSet *complete);

/* Bitmap for Status: chunk i is bit i % 8 of byte i / 8. Returns the number of bytes, at most BITMAP_BYTES. */
int32_t receiver_received_chunks(const FeatureReceiver *self, uint8_t *bitmap);

#endif
