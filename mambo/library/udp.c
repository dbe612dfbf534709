#define _GNU_SOURCE
#include "udp.h"

#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

/* Datagrams of others that one call drops before it gives up. */
#define STRANGERS_MAX 16

bool udp_open(UdpSocket *self, int32_t own_port, const int32_t host[4], int32_t port) {
    struct sockaddr_in own = {.sin_family = AF_INET, .sin_port = htons((uint16_t)own_port)};
    uint32_t address = 0;
    memset(self, 0, sizeof *self);
    for (int i = 0; i < 4; i++) {
        address = address << 8 | (uint32_t)host[i];
    }
    self->peer.sin_family = AF_INET;
    self->peer.sin_port = htons((uint16_t)port);
    self->peer.sin_addr.s_addr = htonl(address);
    own.sin_addr.s_addr = htonl(INADDR_ANY);
    self->descriptor = socket(AF_INET, SOCK_DGRAM, 0);
    if (self->descriptor >= 0 && bind(self->descriptor, (struct sockaddr *)&own, sizeof own) == 0) {
        return true;
    }
    if (self->descriptor >= 0) {
        close(self->descriptor);
    }
    self->descriptor = -1;
    return false;
}

int32_t udp_receive(UdpSocket *self, uint8_t *bytes) {
    for (int i = 0; self->descriptor >= 0 && i < STRANGERS_MAX; i++) {
        struct sockaddr_in sender;
        socklen_t length = sizeof sender;
        ssize_t size =
            recvfrom(self->descriptor, bytes, UDP_BYTES_MAX, MSG_DONTWAIT, (struct sockaddr *)&sender, &length);
        if (size < 0) {
            return -1;
        }
        if (sender.sin_addr.s_addr == self->peer.sin_addr.s_addr && sender.sin_port == self->peer.sin_port) {
            return (int32_t)size;
        }
        self->unknown_sender++;
    }
    return -1;
}

void udp_send(UdpSocket *self, const uint8_t *bytes, size_t size) {
    if (self->descriptor < 0) {
        return;
    }
    ssize_t sent =
        sendto(self->descriptor, bytes, size, MSG_DONTWAIT, (struct sockaddr *)&self->peer, sizeof self->peer);
    if (sent != (ssize_t)size) {
        self->not_sent++;
    }
}
