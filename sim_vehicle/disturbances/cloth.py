from math import cos, pi, sin, sqrt

from pydantic import Field

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.physics.dynamics import cross, rotation, to_body
from sim_vehicle.world.interface import Disturbance

FLAPPING_BANDWIDTH_HZ = 0.5
"""Full width at half maximum of the flapping's spectral line."""


class Cloth(Disturbance):
    """A cloth hanging below the frame: a pendulum, and flapping drag. Defaults: 10 x 10 cm of light fabric."""

    mass_kg: float = Field(default=0.0013, gt=0.0, le=0.02, description="kg (130 g/m^2)")
    length_m: float = Field(default=0.075, ge=0.02, le=0.5, description="m, of the pendulum (0.05-0.1)")
    damping_ratio: float = Field(default=0.15, ge=0.0, le=2.0)
    drag_at_3_m_s_n: float = Field(default=0.034, ge=0.0, description="N, mean drag at 3 m/s; grows with V^2")
    modulation: float = Field(default=0.8, ge=0.0, le=1.0, description="amplitude of the flapping, of the mean drag")
    across: float = Field(default=0.5, ge=0.0, le=1.0, description="amplitude across the wind, of that along it")
    flapping_hz_per_m_s: float = Field(default=2.0, ge=0.0, description="Hz/(m/s), limited to 4-12 Hz")
    fastening_m: float = Field(default=0.022, ge=0.0, description="m below the centre of mass")

    def values(self) -> tuple[float, ...]:
        """[8] the settings, in the order above."""
        return (
            *(self.mass_kg, self.length_m, self.damping_ratio, self.drag_at_3_m_s_n),
            *(self.modulation, self.across, self.flapping_hz_per_m_s, self.fastening_m),
        )

    def start(self, normals: Array) -> tuple[float, ...]:
        """[5] offset of the bob north and east, m, its velocity, m/s, and a random phase of the flapping, rad."""
        return (0.0, 0.0, 0.0, 0.0, abs(float(normals[0])))

    @staticmethod
    def act(v: Array, cloth: Array, time_s: float, state: Array, P: Array, noise: Array, effect: Array) -> None:
        """Add the cloth's force on its fastening, and the torque of that force.

        A bob on small angles (semi-implicit step) gives the inertial part. The drag v[3] (V/3)^2 passes straight to
        the frame, modulated by a narrow-band flapping: an oscillator with phase noise, at a frequency proportional to
        the air speed, limited to 4..12 Hz.
        """
        an, ae, ad = state[at.ACCELERATION], state[at.ACCELERATION + 1], state[at.ACCELERATION + 2]
        step_s, gravity = P[at.STEP], P[at.GRAVITY]
        stiffness = gravity / v[1]
        damping = 2.0 * v[2] * sqrt(stiffness)
        cloth[2] += step_s * (-stiffness * cloth[0] - damping * cloth[2] - an)
        cloth[3] += step_s * (-stiffness * cloth[1] - damping * cloth[3] - ae)
        cloth[0] += step_s * cloth[2]
        cloth[1] += step_s * cloth[3]
        n = v[0] * (stiffness * cloth[0] + damping * cloth[2])
        e = v[0] * (stiffness * cloth[1] + damping * cloth[3])
        d = v[0] * max(0.0, gravity - ad)
        wn, we = state[at.WIND] - state[3], state[at.WIND + 1] - state[4]
        speed = sqrt(wn * wn + we * we)
        frequency = min(12.0, max(4.0, v[6] * speed))
        cloth[4] += 2.0 * pi * frequency * step_s + sqrt(2.0 * pi * FLAPPING_BANDWIDTH_HZ * step_s) * noise[0]
        cloth[4] -= 2.0 * pi * int(cloth[4] / (2.0 * pi))
        if speed > 1.0e-6:
            drag = v[3] * (speed / 3.0) ** 2
            along = drag * (1.0 + v[4] * sin(cloth[4])) / speed
            across = drag * v[5] * v[4] * cos(cloth[4]) / speed
            n += along * wn - across * we
            e += along * we + across * wn
        force = (n, e, d)
        torque = cross((0.0, 0.0, v[7]), to_body(rotation(state[6], state[7], state[8], state[9]), n, e, d))
        for i in range(3):
            effect[at.FORCE + i] += force[i]
            effect[at.TORQUE + i] += torque[i]
