"""MuJoCo in place of the own rigid body and floor. Motors, battery, air and disturbances stay those of the project.

Theory of operation. In each sub-step the project's own functions give the thrust of each rotor, the drag and the
disturbances' force and torque. MuJoCo gets them: thrusts as actuators at the rotors, which turn with the body in every
stage of its Runge-Kutta step, drag and disturbances as a generalised force about the reference point. MuJoCo integrates
the free body with its floor contact for one sub-step. The sums for sensors and truth are then those of the own physics,
from the velocity and rates that MuJoCo has given. Drag is that of the middle of the sub-step, predicted at its start.

MuJoCo's own fluid model is not used: its wind is the same everywhere, and the air here depends on the place.
"""

from math import sqrt
from typing import Any

import sim_vehicle.physics.layout as at
from configs.loader import ConfigError
from protocol.conventions import Array
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.physics.compiled import compiled
from sim_vehicle.physics.disturb import disturb, for_disturbances
from sim_vehicle.physics.dynamics import airframe_drag, rotation, rotor_drag_torque, rotor_lift, to_world
from sim_vehicle.physics.motors import drain_battery, lag_motors
from sim_vehicle.physics.mujoco_model import YAW_ACTUATOR, mjcf
from sim_vehicle.physics.packing import pack_parameters
from sim_vehicle.physics.substep import EFFECT, MIDDLE, THRUST_ROWS, account_substep, note_start, predict_middle

MISSING = (
    "vehicle.physics: 'mujoco': the package mujoco is not installed; install the extra with "
    "pip install '.[mujoco]', or choose 'own'"
)


class MujocoPhysics:
    """Advances one vehicle as `advance` does, with a MuJoCo model of its own.

    Raises
    ------
    ConfigError
        If the package is not installed, or MuJoCo refuses the vehicle's mass or inertia.
    """

    def __init__(self, config: SimVehicleConfig) -> None:
        try:
            import mujoco
        except ImportError as error:
            if not (error.name or "").startswith("mujoco"):
                raise
            raise ConfigError(MISSING) from None
        self._mujoco: Any = mujoco
        self._step = mujoco.mj_step
        self._begin = for_disturbances(begin_substep, config.disturbances)
        self._modelled: Array | None = None
        self._use(pack_parameters(config))

    def __call__(
        self,
        state: Array,
        commands: Array,
        P: Array,
        rows: Array,
        memories: Array,
        noise: Array,
        sums: Array,
        work: Array,
        time_s: float,
        count: int,
    ) -> None:
        """Advance the vehicle. Arguments as for sim_vehicle.physics.advance.advance."""
        if P is not self._modelled:
            self._use(P)
        position, velocity, control, applied = self._arrays
        for k in range(count):
            now_s = time_s + k * P[at.STEP]
            self._begin(state, commands, P, rows, memories, noise[k], sums, work, now_s, control, applied)
            place(state, position, velocity)
            self._step(self._model, self._data)
            end_substep(state, P, sums, work, position, velocity)

    def _use(self, P: Array) -> None:
        """Build the model of these parameters."""
        try:
            self._model = self._mujoco.MjModel.from_xml_string(mjcf(P))
        except ValueError as error:
            raise ConfigError(f"vehicle.body: MuJoCo refuses it: {' '.join(str(error).split())}") from None
        self._data = self._mujoco.MjData(self._model)
        self._arrays = (self._data.qpos, self._data.qvel, self._data.ctrl, self._data.qfrc_applied)
        self._modelled = P


@compiled
def begin_substep(
    state: Array,
    commands: Array,
    P: Array,
    rows: Array,
    memories: Array,
    noise: Array,
    sums: Array,
    work: Array,
    now_s: float,
    control: Array,
    applied: Array,
) -> None:
    """Disturbances, motors, battery and air of the sub-step that starts at `now_s`, as MuJoCo reads them.

    Parameters
    ----------
    state, commands, P, rows, memories, sums: as for `advance`.
    noise: [k, NOISE_PER_ROW], of this sub-step.
    work: [WORK_ROWS, 13] scratch memory; `end_substep` reads the rows NOMINAL and BEFORE.
    control: [5] out, N of each rotor, and N m of all rotors about body up.
    applied: [6] out, force on the reference point, N, MuJoCo's world, and torque, N m, MuJoCo's body.
    """
    thrust, effect = work[:THRUST_ROWS, :4], work[EFFECT, : at.EFFECT_SIZE]
    disturb(state, rows, memories, now_s, P, noise, effect)
    lag_motors(state, commands, P, thrust)
    sums[at.CURRENT] = drain_battery(state, effect[at.VOLTAGE_DROP], P)
    note_start(state, P, work)
    middle = work[MIDDLE]
    predict_middle(state, P, middle)
    R = rotation(middle[6], middle[7], middle[8], middle[9])
    yaw = 0.0
    for i in range(4):
        mean = (thrust[0, i] + 4.0 * thrust[1, i] + thrust[2, i]) / 6.0
        control[i] = rotor_lift(i, middle[at.POSITION + 2], R, mean, P)
        yaw += rotor_drag_torque(i, mean, P)
    control[YAW_ACTUATOR] = -yaw
    drag, drag_torque = airframe_drag(middle, R, state[at.WIND : at.WIND + 3], P)
    push = to_world(R, drag[0], drag[1], drag[2])
    for i in range(3):
        sign = 1.0 if i == 0 else -1.0
        applied[i] = sign * (push[i] + effect[at.FORCE + i])
        applied[3 + i] = sign * (drag_torque[i] + effect[at.TORQUE + i])


@compiled
def place(state: Array, position: Array, velocity: Array) -> None:
    """Write the rigid-body state into MuJoCo's arrays. position: [7] m and wxyz. velocity: [6] m/s and rad/s."""
    for i in range(3):
        sign = 1.0 if i == 0 else -1.0
        position[i] = sign * state[at.POSITION + i]
        velocity[i] = sign * state[at.VELOCITY + i]
        velocity[3 + i] = sign * state[at.RATES + i]
    for i in range(4):
        position[3 + i] = state[at.QUATERNION + i] if i < 2 else -state[at.QUATERNION + i]


@compiled
def end_substep(state: Array, P: Array, sums: Array, work: Array, position: Array, velocity: Array) -> None:
    """Read the state back, and add the sub-step to the sums for sensors and truth. Arguments as above."""
    for i in range(3):
        sign = 1.0 if i == 0 else -1.0
        state[at.POSITION + i] = sign * position[i]
        state[at.VELOCITY + i] = sign * velocity[i]
        state[at.RATES + i] = sign * velocity[3 + i]
    w, x, y, z = position[3], position[4], position[5], position[6]
    scale = 1.0 / sqrt(w * w + x * x + y * y + z * z)
    state[6], state[7], state[8], state[9] = scale * w, scale * x, -scale * y, -scale * z
    account_substep(state, P, sums, work)
