#include "protocol/session.h"

#include <string.h>

#define WORD_BITS 64
#define WORDS (REPLAY_WINDOW / WORD_BITS)

/* ReplayWindow.__init__ */
void replay_window_init(ReplayWindow *self, uint64_t first) {
    memset(self, 0, sizeof *self);
    self->first = self->newest = first;
}

/* ReplayWindow.verdict */
Rejection replay_window_verdict(const ReplayWindow *self, uint64_t sequence) {
    if (sequence > self->newest) {
        return sequence - self->newest <= (uint64_t)SEQUENCE_JUMP_MAX ? REJECTED_NONE : REJECTED_SEQUENCE;
    }
    uint64_t back = self->newest - sequence;
    if (back >= REPLAY_WINDOW) {
        return REJECTED_TOO_OLD;
    }
    return (self->seen[back / WORD_BITS] >> back % WORD_BITS & 1) != 0 ? REJECTED_DUPLICATE : REJECTED_NONE;
}

/* The bits move up by `ahead`, and those that leave the window are forgotten */
static void shift(uint64_t seen[WORDS], uint64_t ahead) {
    uint64_t words = ahead / WORD_BITS, bits = ahead % WORD_BITS;
    for (uint64_t i = WORDS; i-- > 0;) {
        uint64_t low = i >= words ? seen[i - words] : 0, carried = i > words ? seen[i - words - 1] : 0;
        seen[i] = bits == 0 ? low : low << bits | carried >> (WORD_BITS - bits);
    }
}

/* ReplayWindow.accept */
bool replay_window_accept(ReplayWindow *self, uint64_t sequence) {
    self->received++;
    if (sequence > self->newest) {
        uint64_t ahead = sequence - self->newest;
        shift(self->seen, ahead < REPLAY_WINDOW ? ahead : REPLAY_WINDOW);
        self->seen[0] |= 1;
        self->newest = sequence;
        return false;
    }
    uint64_t back = self->newest - sequence;
    self->seen[back / WORD_BITS] |= UINT64_C(1) << back % WORD_BITS;
    self->first = sequence < self->first ? sequence : self->first;
    return back > 0;
}

/* PeerSessions.__init__ */
void peer_sessions_init(PeerSessions *self) {
    memset(self, 0, sizeof *self);
}

/* PeerSessions.is_newer */
bool peer_sessions_is_newer(const PeerSessions *self, uint64_t session) {
    return !self->started || session > self->newest;
}

/* PeerSessions.may_return */
bool peer_sessions_may_return(const PeerSessions *self, uint64_t session) {
    for (int32_t i = 0; i < self->retired_count; i++) {
        if (self->retired[i] == session) {
            return false;
        }
    }
    return self->retired_count < RETIRED_MAX;
}

/* ReplayWindow.lost: numbers between the first and the newest that have not arrived */
static int64_t lost_of(const ReplayWindow *window) {
    return (int64_t)(window->newest - window->first) + 1 - window->received;
}

/* PeerSessions.start */
void peer_sessions_start(PeerSessions *self, uint64_t session, uint64_t sequence) {
    if (self->started) {
        if (self->retired_count < RETIRED_MAX) {
            self->retired[self->retired_count++] = self->current;
        }
        self->lost_before += lost_of(&self->window);
    }
    self->newest = !self->started || session > self->newest ? session : self->newest;
    self->started = true;
    self->current = session;
    replay_window_init(&self->window, sequence);
}

/* PeerSessions.lost */
int64_t peer_sessions_lost(const PeerSessions *self) {
    return self->lost_before + (self->started ? lost_of(&self->window) : 0);
}
