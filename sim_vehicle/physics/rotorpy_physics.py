"""RotorPy in place of the own rigid body, motors and air forces. Battery, floor and disturbances stay the project's.

Theory of operation. Before each sub-step the project's own functions give the commanded rotor speeds, the air at the
vehicle, and the force and torque of all that RotorPy does not model: disturbances, contact with the floor, ground
effect and damaged rotors, each for the middle of the sub-step, predicted at its start. RotorPy's Multirotor gets speeds
and air as its own loop would give them, and adds the force and torque to its own. It integrates body and rotor speeds
for one sub-step. The sums for sensors and truth are then those of the own physics.

RotorPy's ground is not used: it holds a vehicle within 1 mm of it, which at 1 kHz lets nothing lift off slower than
1 m/s. Its gravity, 9.81 m/s^2, is replaced by the project's, which the sensors assume.

RotorPy: Folk, Paulos, Kumar 2023, https://arxiv.org/abs/2306.04485.
"""

from collections.abc import Callable
from math import exp, sqrt
from typing import Any, Final

import numpy as np

import sim_vehicle.physics.layout as at
from configs.loader import ConfigError
from protocol.conventions import GRAVITY, Array
from protocol.geometry import Vector3
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.physics.compiled import compiled
from sim_vehicle.physics.disturb import disturb, for_disturbances
from sim_vehicle.physics.dynamics import (
    FLOOR_REACH,
    cross,
    floor_contact,
    rotation,
    rotor_drag_torque,
    rotor_lift,
    rotor_place,
    to_body,
    to_world,
)
from sim_vehicle.physics.motors import LEAST_THRUST, drain_battery, lag_nominal, turn_rotor
from sim_vehicle.physics.packing import pack_parameters
from sim_vehicle.physics.parameters import RotorpyConfig
from sim_vehicle.physics.rotorpy_model import hover_speed, motor_lag, quad_params
from sim_vehicle.physics.substep import EFFECT, MIDDLE, account_substep, note_start, predict_middle
from sim_vehicle.world.rotorpy_wind import RotorpyWind

MISSING: Final = (
    "vehicle.physics: 'rotorpy': the package rotorpy is not installed; install the extra with "
    "pip install '.[rotorpy]', or choose 'own'"
)
BODY, QUATERNION, RATES, WIND, SPEEDS, ROTORPY_SIZE = 0, 6, 10, 13, 16, 20
"""RotorPy's state as one array, in its order: position and velocity of the centre of mass, quaternion xyzw, rates,
wind, rotor speeds."""


class RotorpyPhysics:
    """Advances one vehicle as `advance` does, with a Multirotor of RotorPy.

    Raises
    ------
    ConfigError
        If the package is not installed, or the drag torque of the rotors is zero, which RotorPy refuses.
    """

    def __init__(self, config: SimVehicleConfig) -> None:
        try:
            from rotorpy.vehicles.multirotor import Multirotor
        except ImportError as error:
            if not (error.name or "").startswith("rotorpy"):
                raise
            raise ConfigError(MISSING) from None
        from sim_vehicle.physics.midpoint import Midpoint

        self._multirotor: Callable[..., Any] = Multirotor
        self._method = {"method": Midpoint}
        self._begin = for_disturbances(begin_substep, config.disturbances)
        self._winds = _winds_of(config)
        self._rotors = config.rotorpy or RotorpyConfig()
        self._hover_rad_s = hover_speed(config)
        self._modelled: Array | None = None
        self._body: Array = np.zeros(ROTORPY_SIZE)
        self._state = {
            "x": self._body[:3],
            "v": self._body[3:6],
            "q": self._body[QUATERNION:RATES],
            "w": self._body[RATES:WIND],
            "wind": self._body[WIND:SPEEDS],
            "rotor_speeds": self._body[SPEEDS:],
        }
        self._speeds: Array = np.zeros(4)
        self._load: Array = np.zeros(6)
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
        step_s, body, speeds, load = float(P[at.STEP]), self._body, self._speeds, self._load
        control = {"cmd_motor_speeds": speeds}
        for k in range(count):
            now_s = time_s + k * step_s
            if self._winds:
                self._blow(state, rows, memories, now_s)
            self._begin(state, commands, P, rows, memories, noise[k], work, now_s, self._half_keep, body, speeds, load)
            moved = self._vehicle.step(self._state, control, step_s)
            for name, part in self._state.items():
                part[:] = moved[name]
            end_substep(state, P, sums, work, body)

    def _use(self, P: Array) -> None:
        """Make the vehicle of these parameters."""
        try:
            vehicle = self._multirotor(quad_params(P, self._hover_rad_s, self._rotors), integrator_kwargs=self._method)
        except np.linalg.LinAlgError as error:
            raise ConfigError(f"vehicle.motors.torque_ratio_m: RotorPy refuses it: {error}") from None
        vehicle.g = GRAVITY
        vehicle.weight = np.array([0.0, 0.0, -vehicle.mass * GRAVITY])
        own, load = vehicle.compute_body_wrench, self._load

        def with_load(rates: Array, speeds: Array, air: Array) -> tuple[Array, Array]:
            force, torque = own(rates, speeds, air)
            return force + load[:3], torque + load[3:]

        vehicle.compute_body_wrench = with_load
        self._vehicle, self._modelled = vehicle, P
        self._half_keep = exp(-0.5 * float(P[at.STEP]) / motor_lag(P))

    def _blow(self, state: Array, rows: Array, memories: Array, now_s: float) -> None:
        """Write the air velocities of RotorPy's winds into their memories."""
        for j, wind, origin in self._winds:
            if rows[j, at.ROW_ONSET] <= now_s + 1.0e-9 < rows[j, at.ROW_END]:
                north, east, down = state[: at.VELOCITY] - origin
                u, v, w = wind.update(now_s - rows[j, at.ROW_ONSET], np.array([north, -east, -down]))
                memories[j, :3] = u, -v, -w


def _winds_of(config: SimVehicleConfig) -> list[tuple[int, Any, Array]]:
    """Of each wind of RotorPy: its row, its object and the origin of its world."""
    acting = [one for one in config.disturbances if one.acts()]
    return [(j, one.profile(), np.array(one.place)) for j, one in enumerate(acting) if isinstance(one, RotorpyWind)]


@compiled
def begin_substep(
    state: Array,
    commands: Array,
    P: Array,
    rows: Array,
    memories: Array,
    noise: Array,
    work: Array,
    now_s: float,
    half_keep: float,
    body: Array,
    speeds: Array,
    load: Array,
) -> None:
    """Disturbances, commands and all that RotorPy does not model, of the sub-step that starts at `now_s`.

    Parameters
    ----------
    state, commands, P, rows, memories: as for `advance`.
    noise: [k, NOISE_PER_ROW], of this sub-step.
    work: [WORK_ROWS, 13] scratch memory; `end_substep` reads the rows EFFECT, NOMINAL and BEFORE.
    half_keep: share of an error of a rotor's speed left after half a sub-step.
    body: [ROTORPY_SIZE] out, RotorPy's state.
    speeds: [4] out, rad/s, commanded.
    load: [6] out, force, N, and torque about the centre of mass, N m, on top of RotorPy's own, in its body axes.
    """
    effect = work[EFFECT, : at.EFFECT_SIZE]
    disturb(state, rows, memories, now_s, P, noise, effect)
    middle = work[MIDDLE]
    predict_middle(state, P, middle)
    R = rotation(middle[6], middle[7], middle[8], middle[9])
    push = to_body(R, effect[at.FORCE], effect[at.FORCE + 1], effect[at.FORCE + 2])
    lift, roll, pitch, yaw = 0.0, effect[at.TORQUE], effect[at.TORQUE + 1], effect[at.TORQUE + 2]
    ratio = state[at.VOLTAGE] / P[at.RATED_VOLTAGE]
    full = P[at.MAX_THRUST] * ratio * ratio
    for i in range(4):
        speeds[i] = sqrt(commands[i] * full * P[at.GAIN + i] / P[at.THRUST_SLOPE])
        start = sqrt(state[at.THRUST + i] / P[at.THRUST_SLOPE])
        turning = speeds[i] + (start - speeds[i]) * half_keep
        thrust = P[at.THRUST_SLOPE] * turning * turning
        x, y = rotor_place(i, P)
        more = rotor_lift(i, middle[at.POSITION + 2], R, thrust, P) - thrust
        lift += more
        roll -= y * more
        pitch += x * more
        sign = 1.0 if i < 2 else -1.0
        yaw += rotor_drag_torque(i, thrust, P) - sign * P[at.TORQUE_RATIO] * thrust
        body[SPEEDS + i] = start
        turn_rotor(state, i, turning, P)
        lag_nominal(state, i, commands[i], P)
    F = (push[0], push[1], push[2] - lift)
    tau = (roll, pitch, yaw)
    if middle[at.POSITION + 2] > -FLOOR_REACH:
        floor = floor_contact(middle, R, (middle[10], middle[11], middle[12]), P)
        F = (F[0] + floor[0], F[1] + floor[1], F[2] + floor[2])
        tau = (tau[0] + floor[3], tau[1] + floor[4], tau[2] + floor[5])
    moment = cross((P[at.CENTRE], P[at.CENTRE + 1], P[at.CENTRE + 2]), F)
    note_start(state, P, work)
    for i in range(3):
        sign = 1.0 if i == 0 else -1.0
        load[i] = sign * F[i]
        load[3 + i] = sign * (tau[i] - moment[i])
        body[WIND + i] = sign * state[at.WIND + i]
    place(state, P, body)


@compiled
def centre_of_mass(state: Array, P: Array) -> tuple[Vector3, Vector3]:
    """Place, m, and velocity, m/s, of the centre of mass from the reference point, world NED."""
    R = rotation(state[6], state[7], state[8], state[9])
    centre = (P[at.CENTRE], P[at.CENTRE + 1], P[at.CENTRE + 2])
    swing = cross((state[10], state[11], state[12]), centre)
    return to_world(R, centre[0], centre[1], centre[2]), to_world(R, swing[0], swing[1], swing[2])


@compiled
def place(state: Array, P: Array, body: Array) -> None:
    """Write position, velocity, quaternion and rates into RotorPy's state, body[ROTORPY_SIZE]."""
    away, moving = centre_of_mass(state, P)
    for i in range(3):
        sign = 1.0 if i == 0 else -1.0
        body[BODY + i] = sign * (state[at.POSITION + i] + away[i])
        body[BODY + 3 + i] = sign * (state[at.VELOCITY + i] + moving[i])
        body[QUATERNION + i] = sign * state[at.QUATERNION + 1 + i]
        body[RATES + i] = sign * state[at.RATES + i]
    body[QUATERNION + 3] = state[at.QUATERNION]


@compiled
def end_substep(state: Array, P: Array, sums: Array, work: Array, body: Array) -> None:
    """Read the state back, drain the battery, and add the sub-step to the sums for sensors and truth.

    Arguments as above; body: RotorPy's state at the end of the sub-step.
    """
    for i in range(3):
        sign = 1.0 if i == 0 else -1.0
        state[at.QUATERNION + 1 + i] = sign * body[QUATERNION + i]
        state[at.RATES + i] = sign * body[RATES + i]
    state[at.QUATERNION] = body[QUATERNION + 3]
    away, moving = centre_of_mass(state, P)
    for i in range(3):
        sign = 1.0 if i == 0 else -1.0
        state[at.POSITION + i] = sign * body[BODY + i] - away[i]
        state[at.VELOCITY + i] = sign * body[BODY + 3 + i] - moving[i]
    for i in range(4):
        thrust = P[at.THRUST_SLOPE] * body[SPEEDS + i] * body[SPEEDS + i]
        state[at.THRUST + i] = thrust if thrust >= LEAST_THRUST else 0.0
    sums[at.CURRENT] = drain_battery(state, work[EFFECT, at.VOLTAGE_DROP], P)
    account_substep(state, P, sums, work)
