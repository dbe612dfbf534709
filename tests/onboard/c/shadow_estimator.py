"""numpy's estimator with the C core's beside it: both get the same calls, and every result is compared."""

from typing import Any

import numpy as np

from onboard.c.event_text import calibration_text, estimator_text
from onboard.estimation.config import EstimatorConfig
from onboard.estimation.estimator import Estimator
from protocol.mavlink.vehicle import FlowReading, ImuReading, SensorReading
from protocol.messages import Pose
from tests.onboard.c.parity import array, configured, same, view

VECTORS = (
    *("position", "velocity", "quaternion", "rotation", "euler", "rates", "specific_force"),
    *("gyro_bias", "accelerometer_bias", "position_jump"),
)
NUMBERS = ("position_sigma_m", "velocity_sigma_m_s", "vibration", "tilt_rad", "yaw_jump")
EXACT = (
    *("time_ns", "height_valid", "initialised", "position_reset_count"),
    *("last_imu_ns", "last_pose_ns", "last_velocity_aid_ns", "last_height_ns"),
)
AIDS = ("flow", "range", "pressure", "pose_position", "pose_attitude")


class ShadowEstimator(Estimator):
    """Raises AssertionError at the first difference. `core` is set by the test before a flight."""

    core: Any = None
    rtol = 1e-9
    """Differences add up over a flight; a single step is compared in test_estimator_blocks.py."""

    def __init__(self, config: EstimatorConfig) -> None:
        super().__init__(config)
        self.ours = self.core.Estimator()
        self.core.estimator_init(self.ours, configured(self.core, config))
        # Views of both states: they are compared after each of thousands of calls.
        self._our_vectors = [view(getattr(self.ours.state, name)) for name in VECTORS]
        self._their_vectors = [getattr(self.state, name).reshape(-1) for name in VECTORS]
        self._our_P = view(self.ours.filter.P).reshape(15, 15)

    def set_on_ground(self, on_ground: bool, at_rest: bool = False) -> None:
        super().set_on_ground(on_ground, at_rest)
        self.core.estimator_set_on_ground(self.ours, on_ground, at_rest)

    def expect_turn(self, u_hat: Any, residual: Any, dt: float) -> None:
        super().expect_turn(u_hat, residual, dt)
        self.core.estimator_expect_turn(self.ours, array(self.core, u_hat), array(self.core, residual), dt)

    def receive(self, reading: SensorReading) -> None:
        super().receive(reading)
        core = self.core
        if isinstance(reading, ImuReading):
            imu = core.ImuReading(time_ns=reading.time_ns, has_pressure=reading.pressure_pa is not None)
            view(imu.accelerometer)[:], view(imu.gyroscope)[:] = reading.accelerometer, reading.gyroscope
            imu.pressure_pa = reading.pressure_pa or 0.0
            core.estimator_receive_imu(self.ours, imu)
        elif isinstance(reading, FlowReading):
            core.estimator_receive_flow(self.ours, core.FlowReading(*reading))
        else:
            core.estimator_receive_range(self.ours, core.RangeReading(reading.time_ns, reading.distance_m))
        self.compare()

    def receive_pose(self, pose: Pose, capture_ns: int, now_ns: int, time_sigma_s: float = 0.0) -> None:
        super().receive_pose(pose, capture_ns, now_ns, time_sigma_s)
        c_pose = self.core.Pose()
        view(c_pose.position)[:], view(c_pose.quaternion)[:] = pose.position_ned_m, pose.quaternion
        self.core.estimator_receive_pose(self.ours, c_pose, capture_ns, now_ns, time_sigma_s)
        self.compare()

    def take_events(self) -> list[tuple[int, str]]:
        events, ours = super().take_events(), (self.core.EstimatorEvent * 64)()
        count = self.core.estimator_take_events(self.ours, ours[0])
        assert [(one.time_ns, estimator_text(one)) for one in ours[:count]] == events
        return events

    def compare(self) -> None:
        """State, covariance, health and calibration."""
        ours, theirs = self.ours.state, self.state
        for name in EXACT:
            assert getattr(ours, name) == getattr(theirs, name), name
        expected = np.concatenate((*self._their_vectors, [getattr(theirs, name) for name in NUMBERS]))
        found = np.concatenate((*self._our_vectors, [getattr(ours, name) for name in NUMBERS]))
        within = self.rtol * max(1.0, float(np.abs(expected).max()))
        assert float(np.abs(found - expected).max()) <= within, (found, expected)
        assert bool((np.abs(self._our_P - self.covariance) <= self.rtol + 1e-5 * np.abs(self.covariance)).all())
        assert self.core.estimator_healthy(self.ours) == self.healthy
        assert list(self.ours.gyro.stuck) == [axis in self._gyro.axes for axis in (0, 1, 2)]

    def compare_counts(self) -> None:
        """All counters and mean scores, at the end of a flight."""
        self.take_events()
        ours, poses = self.ours.corrections, self.ours.poses
        counts = {"imu_gap": self.ours.imu_gaps, "imu_out_of_order": self.ours.imu_out_of_order}
        counts |= {"pose_out_of_order": poses.out_of_order, "pose_wrong_time": poses.wrong_time}
        counts |= {"pose_used": poses.used, "pose_refused": poses.refused, "pose_jump": poses.jumps}
        counts |= {"pose_implausible": poses.implausible, "pose_drift": poses.drifts}
        counts |= {"pose_attitude_refused": poses.attitude_refused}
        for index, aid in enumerate(AIDS):
            for what in ("used", "refused", "recovered"):
                counts.setdefault(f"{aid}_{what}", getattr(ours, what)[index])
        assert {name: count for name, count in counts.items() if count} == dict(self.counts)
        means = {
            aid: ours.score_sums[index] / ours.score_counts[index]
            for index, aid in enumerate(AIDS)
            if ours.score_counts[index]
        }
        assert set(means) == set(self.mean_scores)
        for aid, mean in self.mean_scores.items():
            same(means[aid], mean, 1e-6)
        for aid, score in self.scores.items():
            same(ours.scores[AIDS.index(aid)], score, 1e-5, scale=1.0)
        bench, kept = self.ours.calibration, self.calibration
        assert calibration_text(bench) == kept.refusal
        assert (bench.count, bench.movements) == (kept.count, kept.movements)
        if kept.accepted is not None:
            same(self.core.calibration_along_gravity(bench.accepted), kept.accepted.along_gravity_m_s2, scale=1.0)
