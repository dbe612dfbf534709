"""Poses against the vehicle's own sensors: implausible ones and drifts, each limit with the check switched off, too."""

import math

import numpy as np
import pytest

from onboard.estimation.config import EstimatorConfig
from tests.onboard.estimation.estimator_flights import RATE, Flight, Truth


def test_a_frame_that_moves_a_little_is_followed_and_announced():
    def fault(t, position, quaternion):
        return position + np.array([0.15, 0.1, 0.0]) * (t > 6.0), quaternion

    flight = Flight(truth=Truth(10.0)).run(pose_fault=fault)
    (when, jump, _) = flight.jumps[-1]
    assert len(flight.jumps) == 2
    assert when < 6.3
    np.testing.assert_allclose(jump, (0.15, 0.1, 0.0), atol=0.05)
    moved = flight.errors[int(7.0 * RATE) :, 0:3] + np.array([0.15, 0.1, 0.0])
    assert np.abs(moved).max() < 0.05


def test_a_frame_that_moves_far_is_followed_when_the_flow_may_have_lost_as_much():
    def fault(t, position, quaternion):
        return position + np.array([1.0, 0.5, 0.0]) * (t > 6.0), quaternion

    flight = Flight(truth=Truth(11.0)).run(pose_fault=fault)
    (when, jump, _) = flight.jumps[-1]
    assert len(flight.jumps) == 2
    assert when == pytest.approx(6.0 + (math.hypot(1.0, 0.5) - 0.25) / 0.3, abs=0.4)
    np.testing.assert_allclose(jump, (1.0, 0.5, 0.0), atol=0.15)
    moved = flight.errors[int(10.0 * RATE) :, 0:3] + np.array([1.0, 0.5, 0.0])
    assert np.abs(moved).max() < 0.05


@pytest.mark.parametrize("step", [(0.5, 0.0, 0.0), (0.0, -3.0, 0.0), (0.0, 0.0, 0.6)])
def test_consistent_wrong_poses_are_refused_however_many_agree(step):
    def fault(t, position, quaternion):
        return position + np.array(step) * (6.0 < t < 6.6), quaternion

    def flight(config):
        return Flight(truth=Truth(9.0), config=config).run(pose_fault=fault)

    safe = flight(EstimatorConfig())
    assert safe.estimator.counts["pose_implausible"] >= 28
    assert len(safe.jumps) == 1
    assert np.abs(safe.errors[int(5.0 * RATE) :, 0:3]).max() < 0.1
    blind = flight(EstimatorConfig(pose_jump_m=1e9, pose_drift_m=1e9))
    assert np.abs(blind.errors[int(5.0 * RATE) :, 0:3]).max() > 0.4, "without the check five of them move the estimate"


@pytest.mark.parametrize(
    "velocity", [(1, 0, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (0.5, 0, 0), (0, 0.3, 0), (0, 0, 0.5)]
)
def test_a_drift_of_the_poses_is_found_within_a_metre(velocity):
    def fault(t, position, quaternion):
        return position + max(0.0, t - 6.0) * np.array(velocity), quaternion

    def flight(config):
        return Flight(truth=Truth(11.0), config=config).run(pose_fault=fault)

    found = flight(EstimatorConfig())
    assert found.estimator.counts["pose_drift"] == 1
    assert np.linalg.norm(found.errors[int(5.0 * RATE) :, 0:3], axis=1).max() < 1.0
    assert any(text.startswith("the poses drift, by") for _, text in found.events)
    lost = flight(EstimatorConfig(pose_drift_m=1e9))
    assert np.linalg.norm(lost.errors[-1, 0:3]) > 1.0, "without the check the estimate follows the poses"


@pytest.mark.parametrize("velocity", [(2.0, 0.0, 0.0), (0.0, 5.0, 0.0)])
def test_a_faster_drift_is_implausible_at_once(velocity):
    def fault(t, position, quaternion):
        return position + max(0.0, t - 6.0) * np.array(velocity), quaternion

    flight = Flight(truth=Truth(9.0)).run(pose_fault=fault)
    assert flight.estimator.counts["pose_implausible"] > 50
    assert np.linalg.norm(flight.errors[int(5.0 * RATE) :, 0:3], axis=1).max() < 1.0


def test_a_height_that_the_pressure_does_not_confirm_is_no_drift():
    def table(t, distance):
        return max(0.44, distance - 0.6) if 4.0 < t < 7.0 else distance

    flight = Flight(truth=Truth(9.0)).run(range_fault=table)
    assert flight.estimator.counts["pose_drift"] == 0
    assert np.abs(flight.errors[800:, 2]).max() < 0.03
