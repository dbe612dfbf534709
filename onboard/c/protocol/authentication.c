#include "protocol/authentication.h"

/* Authenticator.__init__ */
bool authenticator_init(Authenticator *self, const uint8_t *key, int32_t key_size, Direction direction) {
    static const char persons[2][BLAKE2B_PERSON_BYTES + 1] = {"async-dmrac up", "async-dmrac down"};
    if (key_size != 0 && !(KEY_MIN_BYTES <= key_size && key_size <= KEY_MAX_BYTES)) {
        return false;
    }
    blake2b_start(&self->start, MAC_BYTES, key, key_size, (const uint8_t *)persons[direction]);
    return true;
}

/* Authenticator.mac */
void authenticator_mac(const Authenticator *self, const uint8_t *data, size_t size, uint8_t mac[MAC_BYTES]) {
    Blake2b hash = self->start;
    blake2b_add(&hash, data, size);
    blake2b_finish(&hash, mac);
}

/* Authenticator.is_genuine */
bool authenticator_is_genuine(const Authenticator *self, const uint8_t *datagram, size_t size) {
    uint8_t mac[MAC_BYTES], difference = 0;
    authenticator_mac(self, datagram, size - MAC_BYTES, mac);
    for (size_t i = 0; i < MAC_BYTES; i++) {
        difference |= mac[i] ^ datagram[size - MAC_BYTES + i];
    }
    return difference == 0;
}
