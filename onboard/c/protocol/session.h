/* Sessions of the peer and their replay windows: the twin of protocol/session.py, which has the rules. */
#ifndef DMRAC_SESSION_H
#define DMRAC_SESSION_H

#include <stdbool.h>
#include <stdint.h>

#include "generated/constants.h"

/* The sequence numbers received in one session: the newest, a bitmap of those before it, and counts. */
typedef struct {
    uint64_t seen[REPLAY_WINDOW / 64]; /* bit i % 64 of word i / 64 stands for newest - i */
    uint64_t first;
    uint64_t newest;
    int64_t received;
} ReplayWindow;

/* The current session of the peer, and the retired ones. */
typedef struct {
    bool started; /* there is a current session */
    uint64_t current;
    uint64_t newest; /* the largest number accepted so far */
    ReplayWindow window;
    uint64_t retired[RETIRED_MAX]; /* once full, rule 3 has ended and no more are stored */
    int32_t retired_count;
    int64_t lost_before; /* in earlier sessions */
} PeerSessions;

void replay_window_init(ReplayWindow *self, uint64_t first);
/* REJECTED_NONE if the number is new, else the reason against it. */
Rejection replay_window_verdict(const ReplayWindow *self, uint64_t sequence);
/* Store a number as received; whether it came out of order. Call only if the verdict is REJECTED_NONE. */
bool replay_window_accept(ReplayWindow *self, uint64_t sequence);

void peer_sessions_init(PeerSessions *self);
/* Whether the session number is above all accepted before (rule 1). */
bool peer_sessions_is_newer(const PeerSessions *self, uint64_t session);
/* Whether rule 3 may accept the session: it is not retired, and the list of retired ones is still complete. */
bool peer_sessions_may_return(const PeerSessions *self, uint64_t session);
/* Retire the current session and start another, whose first received number is `sequence`. */
void peer_sessions_start(PeerSessions *self, uint64_t session, uint64_t sequence);
/* Lost datagrams, in all sessions. */
int64_t peer_sessions_lost(const PeerSessions *self);

#endif
