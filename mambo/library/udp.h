/* UDP sockets that never wait. */
#ifndef DMRAC_MAMBO_UDP_H
#define DMRAC_MAMBO_UDP_H

#include <netinet/in.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define UDP_BYTES_MAX 1472

typedef struct {
    int descriptor; /* -1: closed */
    struct sockaddr_in peer;
    int64_t unknown_sender; /* datagrams of others, dropped */
    int64_t not_sent;
} UdpSocket;

/* host: IPv4, the most significant octet first. False if the port is taken; `self` is closed then. */
bool udp_open(UdpSocket *self, int32_t own_port, const int32_t host[4], int32_t port);

/* A datagram of the peer, at most UDP_BYTES_MAX bytes; its size, or -1 if none waits. */
int32_t udp_receive(UdpSocket *self, uint8_t *bytes);

/* A datagram that cannot be sent now is lost and counted. */
void udp_send(UdpSocket *self, const uint8_t *bytes, size_t size);

#endif
