"""Motion capture of the room, which reports to the offboard host."""

from typing import NamedTuple

import numpy as np

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from protocol.geometry import Quaternion, Vector3, normalised, quaternion_multiply
from sim_vehicle.physics.draws import Draws
from sim_vehicle.physics.parameters import MotionCaptureConfig
from sim_vehicle.sensors.schedule import Schedule


class PoseSample(NamedTuple):
    """A solved frame."""

    position_m: Vector3
    quaternion: Quaternion
    velocity_m_s: Vector3
    """Body FRD, from the difference of two frames."""


class MotionCapture:
    """The cameras. The random stream is [seed, stream]."""

    def __init__(self, config: MotionCaptureConfig, seed: int, stream: int) -> None:
        self.config = config
        self.schedule = Schedule(config.rate_hz)
        rng = np.random.default_rng([seed, stream])
        self._normals, self._uniforms = Draws(rng.standard_normal), Draws(rng.spawn(1)[0].random)
        self._last: tuple[int, Vector3] | None = None

    def sample(self, state: Array, now_ns: int) -> PoseSample | None:
        """The pose of this frame, or None when it is not solved."""
        config = self.config
        n1, n2, n3, n4, n5, n6 = self._normals.several(6)
        lost = self._uniforms.take() < config.loss_probability
        n, e, d, _, _, _, w, x, y, z = state[: at.RATES].tolist()
        noise = config.position_noise_m
        position = (n + noise * n1, e + noise * n2, d + noise * n3)
        noise = 0.5 * config.attitude_noise_rad
        quaternion = normalised(quaternion_multiply((w, x, y, z), (1.0, noise * n4, noise * n5, noise * n6)))
        now_s = now_ns * 1e-9
        if lost or (config.outages and any(outage.start_s <= now_s < outage.end_s for outage in config.outages)):
            return None
        velocity = (0.0, 0.0, 0.0)
        if self._last is not None:
            dt = (now_ns - self._last[0]) * 1e-9
            (n, e, d), (last_n, last_e, last_d) = position, self._last[1]
            velocity = _to_body(quaternion, ((n - last_n) / dt, (e - last_e) / dt, (d - last_d) / dt))
        self._last = (now_ns, position)
        return PoseSample(position, quaternion, velocity)


def _to_body(q: Quaternion, v: Vector3) -> Vector3:
    """World to body: q* v q."""
    conjugate = (q[0], -q[1], -q[2], -q[3])
    turned = quaternion_multiply(quaternion_multiply(conjugate, (0.0, *v)), q)
    return (turned[1], turned[2], turned[3])
