/* Authentication of datagrams: the twin of protocol/authentication.py. */
#ifndef DMRAC_AUTHENTICATION_H
#define DMRAC_AUTHENTICATION_H

#include <stdbool.h>

#include "generated/constants.h"
#include "protocol/blake2b.h"

typedef enum {
    DIRECTION_UP,  /* onboard to offboard */
    DIRECTION_DOWN /* offboard to onboard */
} Direction;

/* Computes and checks the MAC of one direction. */
typedef struct {
    Blake2b start;
} Authenticator;

/* key_size: KEY_MIN_BYTES to KEY_MAX_BYTES, or 0 for none; false for another one, and `self` must not be used then. */
bool authenticator_init(Authenticator *self, const uint8_t *key, int32_t key_size, Direction direction);

/* The MAC of header and body. */
void authenticator_mac(const Authenticator *self, const uint8_t *data, size_t size, uint8_t mac[MAC_BYTES]);

/* Whether the last MAC_BYTES of the datagram are the MAC of the bytes before them; compared in constant time. The datagram
 * has at least MAC_BYTES. */
bool authenticator_is_genuine(const Authenticator *self, const uint8_t *datagram, size_t size);

#endif
