"""The whole estimator along flights with faults: the C core beside numpy's, every result compared."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from onboard.c.library import Core
from onboard.estimation.config import EstimatorConfig
from protocol.mavlink.vehicle import FlowReading, ImuReading, RangeReading
from protocol.messages import Pose
from tests.onboard.c.parity import SANITIZED, same
from tests.onboard.c.shadow_estimator import ShadowEstimator
from tests.onboard.estimation import estimator_flights
from tests.onboard.estimation.estimator_flights import Flight, Noise, Truth

SECONDS = 6.0


@pytest.fixture
def shadow(core: Core, monkeypatch: pytest.MonkeyPatch) -> type[ShadowEstimator]:
    """numpy's estimator in the flights is replaced by the pair."""
    monkeypatch.setattr(ShadowEstimator, "core", core)
    monkeypatch.setattr(estimator_flights, "Estimator", ShadowEstimator)
    return ShadowEstimator


def moved_frame(t: float, position: Any, quaternion: Any) -> Any:
    if t < 3.0:
        return position, quaternion
    turned = Rotation.from_euler("z", 0.6) * Rotation.from_quat(quaternion[[1, 2, 3, 0]])
    return position + np.array([0.5, -0.3, 0.0]), turned.as_quat()[[3, 0, 1, 2]]


def outliers(t: float, position: Any, quaternion: Any) -> Any:
    wild = math.sin(97.0 * t) > 0.8
    return (position + np.array([2.0, 0.0, -1.0]) if wild else position), quaternion


def turned(angle: float) -> Callable[[float, Any, Any], Any]:
    wrong = Rotation.from_euler("y", angle).as_quat()[[3, 0, 1, 2]]
    return lambda t, position, quaternion: (position, wrong if 3.0 < t < 3.5 else quaternion)


def drifting(n: float, e: float, d: float) -> Callable[[float, Any, Any], Any]:
    return lambda t, position, quaternion: (position + max(0.0, t - 3.5) * np.array([n, e, d]), quaternion)


def gaps(t: float, imu: ImuReading) -> ImuReading | None:
    return None if 3.0 < t < 3.2 else imu


def out_of_order(t: float, imu: ImuReading) -> ImuReading:
    return imu._replace(time_ns=imu.time_ns - 40_000_000) if 3.0 < t < 3.05 else imu


def without_pressure(t: float, imu: ImuReading) -> ImuReading:
    return imu._replace(pressure_pa=None) if t > 3.0 else imu


def chipped_rotor(t: float, imu: ImuReading) -> ImuReading:
    x, y, z = imu.accelerometer
    shake = 12.0 * math.sin(2.0 * math.pi * 177.3 * t)
    return imu._replace(accelerometer=(x + shake, y - shake, z)) if t > 2.5 else imu


class Stuck:
    """An axis that keeps its value from 3 s on; a second one from 3.5 s on."""

    def __init__(self, axes: tuple[int, ...]) -> None:
        self.axes, self.kept = axes, {}

    def __call__(self, t: float, imu: ImuReading) -> ImuReading:
        rates = list(imu.gyroscope)
        for index, axis in enumerate(self.axes):
            if t > 3.0 + 0.5 * index:
                rates[axis] = self.kept.setdefault(axis, rates[axis])
        return imu._replace(gyroscope=(rates[0], rates[1], rates[2]))


def wrong_stamps(pose: Pose, now_ns: int) -> int:
    return pose.time_ns - (700_000_000 if pose.time_ns % 100_000_000 == 0 else 0)


def wrong_range(t: float, distance: float) -> float:
    return distance + 0.8 if t > 3.0 else distance


ALL, NEVER = ((0.0, 1e9),), ((0.0, 0.0),)
FLIGHTS: dict[str, tuple[dict[str, Any], Callable[[], dict[str, Any]], str]] = {
    "with poses": ({}, dict, "pose_used"),
    "late first pose": ({"pose_windows": ((3.0, 1e9),)}, dict, "pose_jump"),
    "first pose elsewhere": (
        {"truth": Truth(SECONDS, start=(2.0, -1.0), yaw_start=0.7), "pose_windows": ((2.5, 1e9),)},
        dict,
        "pose_jump",
    ),
    "outage": ({"pose_windows": ((0.0, 2.0), (3.5, 1e9))}, dict, "pose_used"),
    "on flow and range": ({"pose_windows": NEVER}, dict, "flow_used"),
    "without any aid": ({"pose_windows": NEVER, "flow_windows": NEVER}, dict, "pressure_used"),
    "moved frame": ({}, lambda: {"pose_fault": moved_frame}, "pose_jump"),
    "outliers": ({}, lambda: {"pose_fault": outliers}, "pose_refused"),
    "wrong attitude": ({}, lambda: {"pose_fault": turned(0.4)}, "pose_attitude_refused"),
    "impossible attitude": ({}, lambda: {"pose_fault": turned(1.2)}, "pose_implausible"),
    "drifting poses": ({}, lambda: {"pose_fault": drifting(0.7, -0.7, 0.0)}, "pose_drift"),
    "drifting height": ({}, lambda: {"pose_fault": drifting(0.0, 0.0, 0.8)}, "pose_drift"),
    "gap": ({}, lambda: {"imu_fault": gaps}, "imu_gap"),
    "out of order": ({}, lambda: {"imu_fault": out_of_order}, "imu_out_of_order"),
    "without pressure": ({"pose_windows": NEVER}, lambda: {"imu_fault": without_pressure}, "range_used"),
    "chipped rotor": ({}, lambda: {"imu_fault": chipped_rotor}, "pose_used"),
    "stuck axis": ({}, lambda: {"imu_fault": Stuck((0,))}, "gyro_stuck"),
    "two stuck axes": ({}, lambda: {"imu_fault": Stuck((2, 1))}, "gyro_stuck"),
    "stuck axis without poses": ({"pose_windows": NEVER}, lambda: {"imu_fault": Stuck((1,))}, "gyro_stuck"),
    "wrong stamps": ({}, lambda: {"stamp_fault": wrong_stamps}, "pose_wrong_time"),
    "wrong range": ({"pose_windows": NEVER}, lambda: {"range_fault": wrong_range}, "range_recovered"),
    "uncertain clock": ({"noise": Noise(pose_delay_s=0.08)}, lambda: {"time_sigma_s": 0.004}, "pose_used"),
    "every sample": ({"config": EstimatorConfig(covariance_every=1, gyro_delay_s=0.0)}, dict, "pose_used"),
}
"""Settings, faults, and what must have happened: else the flight would compare nothing of its fault."""
WATCHED = (
    "moved frame",
    "wrong attitude",
    "drifting height",
    "two stuck axes",
    "stuck axis without poses",
    "wrong range",
)
"""The flights that the sanitizers watch."""


@pytest.mark.parametrize("name", FLIGHTS)
def test_a_flight(shadow: type[ShadowEstimator], name: str) -> None:
    if SANITIZED and name not in WATCHED:
        pytest.skip("the sanitizers watch a few flights only")
    settings, faults, happened = FLIGHTS[name]
    estimator = Flight(**{"truth": Truth(SECONDS), **settings}).run(**faults()).estimator
    estimator.compare_counts()
    assert estimator.gyro_stuck if happened == "gyro_stuck" else estimator.counts[happened] > 0


def test_at_rest_with_calibration_and_after_the_landing(shadow: type[ShadowEstimator]) -> None:
    """Calibrated, flown with a stuck axis, landed: the gyroscope is believed again."""
    rng, estimator = np.random.default_rng(2), shadow(EstimatorConfig())
    kept = None
    for k in range(1, 1400):
        now_ns, flying = k * 5_000_000, 700 < k < 1100
        estimator.set_on_ground(not flying, not 600 < k < 1300)
        estimator.expect_turn(rng.normal(size=3), rng.normal(size=3), 0.005)
        force = [0.09, -0.06, -9.5] + 0.2 * rng.normal(size=3)
        rate = [0.02, 0.03, -0.01] + 0.02 * rng.normal(size=3)
        if k > 850:
            kept = rate[0] if kept is None else kept
            rate[0] = kept
        estimator.receive(ImuReading(now_ns, (*force.tolist(),), (*rate.tolist(),), 101_325.0 + rng.normal()))
        if k % 4 == 0:
            flow = (*(0.01 * rng.normal(size=4)).tolist(), 100)
            estimator.receive(FlowReading(now_ns, 0.015, *flow))
            estimator.receive(RangeReading(now_ns, 0.9))
        estimator.take_events()
    assert estimator.calibration.count == 1
    assert estimator.counts["imu_gap"] == 0
    estimator.compare_counts()


def test_a_filter_that_is_not_finite_is_not_healthy(shadow: type[ShadowEstimator]) -> None:
    estimator = shadow(EstimatorConfig())
    for k in range(1, 60):
        estimator.receive(ImuReading(k * 5_000_000, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0)))
    assert estimator.core.estimator_healthy(estimator.ours)
    estimator.ours.filter.velocity[1] = math.nan
    assert not estimator.core.estimator_healthy(estimator.ours)


def test_the_shadow_finds_a_difference(shadow: type[ShadowEstimator]) -> None:
    estimator = shadow(EstimatorConfig())
    for k in range(1, 60):
        estimator.receive(ImuReading(k * 5_000_000, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0)))
    estimator.ours.filter.velocity[1] += 1e-7
    with pytest.raises(AssertionError):
        estimator.receive(ImuReading(60 * 5_000_000, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0)))


def test_float_stays_near_double(core32: Core) -> None:
    """A flight with poses in float: the estimate stays within millimetres of numpy's."""
    flight = Flight(truth=Truth(SECONDS))
    recorded: list[tuple[str, tuple[Any, ...]]] = []

    class Recorder(estimator_flights.Estimator):  # type: ignore[name-defined, misc]
        def receive(self, reading: Any) -> None:
            recorded.append(("receive", (reading,)))
            super().receive(reading)

        def receive_pose(self, *given: Any) -> None:
            recorded.append(("receive_pose", given))
            super().receive_pose(*given)

        def set_on_ground(self, *given: Any) -> None:
            recorded.append(("set_on_ground", given))
            super().set_on_ground(*given)

    original = estimator_flights.Estimator
    estimator_flights.Estimator = Recorder
    try:
        theirs = flight.run().estimator
    finally:
        estimator_flights.Estimator = original
    ShadowEstimator.core = core32
    try:
        ours = _Loose(EstimatorConfig())
        for name, given in recorded:
            getattr(ours, name)(*given)
    finally:
        ShadowEstimator.core = None
    same(ours.ours.state.position, theirs.state.position, 3e-3, scale=1.0)
    same(ours.ours.state.velocity, theirs.state.velocity, 1e-2, scale=1.0)
    same(ours.ours.state.quaternion, theirs.state.quaternion, 3e-3, scale=1.0)


class _Loose(ShadowEstimator):
    """Compares nothing on the way."""

    def compare(self) -> None:
        pass
