"""Artificial flights for the tests of the offboard side: a figure-8 through a jet, with an optional rotor fault."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from configs.loader import fill, merge, read_tree
from offboard.config import OffboardConfig
from protocol.conventions import Array
from protocol.messages import SampleBatch
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX

PERIOD_S = 0.02
PERIOD_NS = 20_000_000
ROOT = Path(__file__).resolve().parents[2]


def offboard_config(**over: object) -> OffboardConfig:
    """The shipped configuration, but that the first round comes early."""
    tree = {"features": read_tree(ROOT / "configs" / "features.yaml"), "trainer": {"minimum_samples": 60}}
    return fill(OffboardConfig, merge(tree, over), "test")


@dataclass(frozen=True, eq=False)
class Flight:
    """Truth and samples of n periods."""

    signals: Array
    """[n, SIGNAL_COUNT], as estimated."""
    delivered: Array
    """[n, 2, 3]: u_hat, averaged over the period that ends at the sample."""
    delta: Array
    """[n, 2, 3]: the true uncertainty at the sample."""

    def batches(self, size: int = 5, first_index: int = 0, time_ns: int = 10**9, version: int = 0) -> list[SampleBatch]:
        """All samples, in complete batches."""
        out = []
        for start in range(0, self.signals.shape[0] - size + 1, size):
            rows = slice(start, start + size)
            out.append(
                SampleBatch(
                    first_index + start,
                    time_ns + start * PERIOD_NS,
                    PERIOD_NS,
                    version,
                    self.signals[rows].astype(np.float32),
                    self.delivered[rows].astype(np.float32),
                    self.delta[rows].astype(np.float32),
                )
            )
        return out


def figure8_through_jet(
    duration_s: float = 20.0,
    seed: int = 0,
    jet_m_s: float = 6.0,
    gust_m_s2: float = 0.1,
    noise: float = 1.0,
    fault_s: float = 1e9,
    hover: bool = False,
    lap_s: float = 5.0,
) -> Flight:
    """A figure-8 of 1 m by 0.5 m with an eastward jet across its middle. From `fault_s` on, rotor 1 gives 30 % less."""
    steps = 8
    n = round(duration_s / PERIOD_S) * steps
    t = np.arange(n + 1) * (PERIOD_S / steps)
    rng = np.random.default_rng([seed, 77])
    position, velocity, acceleration = _path(t, hover, lap_s)
    gusts = _gusts(rng, n + 1, PERIOD_S / steps, gust_m_s2)
    fault = (t > fault_s).astype(float)
    thrust = _motor_thrusts(acceleration, fault, rng)
    linear = _jet_acceleration(position, velocity, jet_m_s) + gusts
    linear[:, 2] += 0.9 - 1.2 * fault  # the motors are weaker than their map
    angular = _jet_moments(position, jet_m_s) + 10.0 * gusts[:, [1, 0, 2]] * [1, -1, 0.2]
    angular[:, 0] -= fault * 25.0
    angular[:, 1] += fault * 20.0
    delta = np.stack([linear, angular], axis=1)
    return _sampled(t, steps, position, velocity, acceleration, thrust, delta, noise, rng)


def _path(t: Array, hover: bool, lap_s: float) -> tuple[Array, Array, Array]:
    omega = 0.0 if hover else 2.0 * np.pi / lap_s
    wander = 0.05
    s, c, s2, c2 = np.sin(omega * t), np.cos(omega * t), np.sin(2 * omega * t), np.cos(2 * omega * t)
    position = np.stack([s, 0.5 * s2, -1.0 + wander * np.sin(3.0 * t)], axis=1)
    velocity = np.stack([omega * c, omega * c2, 3.0 * wander * np.cos(3.0 * t)], axis=1)
    acceleration = np.stack([-(omega**2) * s, -2.0 * omega**2 * s2, -9.0 * wander * np.sin(3.0 * t)], axis=1)
    return position, velocity, acceleration


def _gusts(rng: np.random.Generator, n: int, dt: float, sigma: float) -> Array:
    a = np.exp(-dt / 0.3)
    drive = sigma * np.sqrt(1.0 - a * a) * rng.standard_normal((n, 3))
    gusts = np.zeros((n, 3))
    for i in range(1, n):
        gusts[i] = a * gusts[i - 1] + drive[i]
    return gusts


def _jet_wind(position: Array, jet_m_s: float) -> Array:
    """Wind speed at the vehicle, of a Gaussian jet that blows east from (0.3, -1.5, -1)."""
    along = np.maximum(position[:, 1] + 1.5, 0.05)
    across = np.hypot(position[:, 0] - 0.3, position[:, 2] + 1.0)
    half_width = 0.1 + 0.11 * along
    centre = jet_m_s * np.minimum(1.0, 6.2 * 0.3 / along)
    speed = np.zeros_like(position)
    speed[:, 1] = centre * np.exp(-np.log(2.0) * (across / half_width) ** 2)
    return speed


def _jet_acceleration(position: Array, velocity: Array, jet_m_s: float) -> Array:
    air = _jet_wind(position, jet_m_s) - velocity
    speed = np.linalg.norm(air, axis=1, keepdims=True)
    force: Array = (0.016 + 4.7e-3 * speed) * air
    return force / 0.063


def _jet_moments(position: Array, jet_m_s: float) -> Array:
    wind = _jet_wind(position, jet_m_s)[:, 1]
    moments = np.zeros_like(position)
    moments[:, 0] = 3.0 * wind
    moments[:, 1] = 1.5 * wind * np.tanh(4.0 * (position[:, 0] - 0.3))
    return moments


def _motor_thrusts(acceleration: Array, fault: Array, rng: np.random.Generator) -> Array:
    total = 0.063 * np.linalg.norm(acceleration - np.array([0.0, 0.0, 9.81]), axis=1) * 1.1
    thrust = total[:, None] / 4.0 * (1.0 + 0.03 * rng.standard_normal((1, 4))) * np.ones((1, 4))
    thrust[:, 0] += 0.05 * fault
    thrust[:, 2] += 0.01 * fault
    return thrust


def _sampled(
    t: Array,
    steps: int,
    position: Array,
    velocity: Array,
    acceleration: Array,
    thrust: Array,
    delta: Array,
    noise: float,
    rng: np.random.Generator,
) -> Flight:
    """u_hat = v_dot - Delta; the body rates come from an independent small motion."""
    rates = 0.5 * np.stack([np.sin(3.1 * t), np.cos(2.7 * t), 0.3 * np.sin(1.3 * t)], axis=1)
    rates_dot = 0.5 * np.stack([3.1 * np.cos(3.1 * t), -2.7 * np.sin(2.7 * t), 0.39 * np.cos(1.3 * t)], axis=1)
    u_hat = np.stack([acceleration, rates_dot], axis=1) - delta
    at = np.arange(steps, t.size, steps)
    n = at.size
    mean = (0.5 * (u_hat[:-1] + u_hat[1:])).reshape(n, steps, 2, 3).mean(axis=1)
    signals = np.zeros((n, SIGNAL_COUNT))

    def put(names: tuple[str, ...], values: Array, sigma: float) -> None:
        columns = [SIGNAL_INDEX[name] for name in names]
        signals[:, columns] = values[at] + noise * sigma * rng.standard_normal((n, len(columns)))

    put(("position_n", "position_e", "position_d"), position, 0.005)
    put(("velocity_n", "velocity_e", "velocity_d"), velocity, 0.01)
    put(("body_velocity_x", "body_velocity_y", "body_velocity_z"), velocity, 0.01)
    put(("rate_p", "rate_q", "rate_r"), rates, 0.015)
    put(tuple(f"motor_thrust_{i}" for i in range(1, 5)), thrust, 0.003)
    put(("battery_voltage",), np.full((t.size, 1), 3.8), 0.01)
    put(("vibration",), np.full((t.size, 1), 1.0), 0.1)
    return Flight(signals, mean, delta[at])
