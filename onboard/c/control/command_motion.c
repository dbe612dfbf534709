#include "control/command_motion.h"

#include <string.h>

#include "generated/constants.h"
#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* CommandMotion.__init__ */
void command_motion_init(CommandMotion *self, real filter_s, real path_turn) {
    memset(self, 0, sizeof *self);
    self->filter_s = filter_s;
    self->share = path_turn;
    self->commanded[0] = REAL(1.0);
}

/* CommandMotion._path_turn: as it is fed forward; zero where no path is */
static void find_path_turn(CommandMotion *self, const ControlInputs *inputs) {
    const PathTurn *turn = &inputs->target->turn;
    real R[9];
    vector_zero(self->omega_d);
    vector_zero(self->alpha_d);
    if (self->share == REAL(0.0) || !inputs->adapt || inputs->level_only) {
        return;
    }
    for (int i = 0; i < 9; i++) {
        R[i] = self->share * inputs->state->rotation[i];
    }
    matrix_transposed_times(R, turn->rate, self->omega_d);
    matrix_transposed_times(R, turn->acceleration, self->alpha_d);
}

/* CommandMotion.step */
void command_motion_step(CommandMotion *self, const real commanded[4], const ControlInputs *inputs) {
    const real *turn = self->turn;
    find_path_turn(self, inputs);
    turn_between(self->commanded, commanded, self->turn);
    memcpy(self->commanded, commanded, sizeof self->commanded);
    if (self->filter_s == REAL(0.0) || !inputs->adapt) {
        vector_zero(self->added_rate);
        return;
    }
    bool jump = real_max(real_max(real_abs(turn[0]), real_abs(turn[1])), real_abs(turn[2])) > COMMAND_JUMP_RAD;
    real share = REAL(1.0) - real_exp(-inputs->dt / self->filter_s);
    for (int i = 0; i < 3; i++) {
        real added = jump ? REAL(0.0) : turn[i] / inputs->dt - self->omega_d[i];
        self->added_rate[i] += share * (added - self->added_rate[i]);
        self->omega_d[i] += self->added_rate[i];
    }
}
