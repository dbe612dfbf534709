"""The motion of the commanded attitude as it is fed forward: omega_d and alpha_d.

Theory of operation. The path's own turn is known without noise (onboard/flight/path_turn.py), so its rate and its
acceleration are fed forward as they are. What feedback adds to the command's rate is noise in part; only that is
filtered, and its acceleration is not used.
"""

from math import exp

from onboard.control.records import ControlInputs
from protocol.geometry import Quaternion, Vector3, add, quaternion_multiply, quaternion_to_rotation_vector, vector

COMMAND_JUMP_RAD = 0.2
"""A commanded attitude that changes by more in a tick is a new command, and its change no rate."""


class CommandMotion:
    """Body FRD; zero on the ground.

    Parameters
    ----------
    filter_s: time constant on what feedback adds to the rate, s; 0: that is not fed forward.
    path_turn: share of the path's turn that is fed forward, 0 to 1.
    """

    def __init__(self, filter_s: float, path_turn: float) -> None:
        self._filter_s = filter_s
        self._share = path_turn
        self._commanded: Quaternion = (1.0, 0.0, 0.0, 0.0)
        self._added_rate: Vector3 = (0.0, 0.0, 0.0)
        self.turn: Vector3 = (0.0, 0.0, 0.0)
        """Of the commanded attitude since the last tick, rad."""
        self.omega_d: Vector3 = (0.0, 0.0, 0.0)
        """rad/s."""
        self.alpha_d: Vector3 = (0.0, 0.0, 0.0)
        """rad/s^2."""

    def step(self, commanded: Quaternion, inputs: ControlInputs) -> None:
        """Update with the attitude commanded in this tick."""
        path_rate, self.alpha_d = self._path_turn(inputs)
        w, x, y, z = self._commanded
        self._commanded = commanded
        self.turn = turn = quaternion_to_rotation_vector(quaternion_multiply((w, -x, -y, -z), commanded))
        if self._filter_s == 0.0 or not inputs.adapt:
            self._added_rate, self.omega_d = (0.0, 0.0, 0.0), path_rate
            return
        jump = max(map(abs, turn)) > COMMAND_JUMP_RAD
        share = 1.0 - exp(-inputs.dt / self._filter_s)
        each_axis = zip(self._added_rate, turn, path_rate, strict=True)
        self._added_rate = vector(
            rate + share * ((0.0 if jump else t / inputs.dt - path) - rate) for rate, t, path in each_axis
        )
        self.omega_d = add(path_rate, self._added_rate)

    def _path_turn(self, inputs: ControlInputs) -> tuple[Vector3, Vector3]:
        """Rate and acceleration of the path's turn, as they are fed forward; zero where no path is."""
        if self._share == 0.0 or not inputs.adapt or inputs.level_only:
            return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = (inputs.state.rotation * self._share).tolist()
        rate, acceleration = (
            (r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z)
            for x, y, z in inputs.target.turn
        )
        return rate, acceleration
