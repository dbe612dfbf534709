"""Pose checks before arming: which poses are good enough, and the text for each fault."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from onboard.estimation.pose_health import EVERY, NOT_COMPARED, PoseHealth, PoseHealthConfig

REST = np.array([0.0, 0.0, -9.81])


def judged(poses=40, period_s=0.01, attitude=None, down=-0.02, force=REST, order=(3, 0, 1, 2)):
    health = PoseHealth(PoseHealthConfig())
    quaternion = (attitude or Rotation.from_euler("z", 1.2)).as_quat()
    for k in range(poses):
        health.add(down, tuple(quaternion[list(order)]), round(k * period_s * 1e9), force)
    return health.fault


@pytest.mark.parametrize(
    ("poses", "fault"),
    [
        ({}, ""),
        ({"poses": EVERY - 1, "down": -5.0}, ""),
        ({"poses": EVERY, "down": -5.0}, "pose is +5.00 m"),
        ({"period_s": 0.1}, "pose at 10 Hz"),
        ({"force": np.zeros(3)}, NOT_COMPARED),
        ({"attitude": Rotation.from_euler("ZYX", (1.0, 0.1, -0.1)), "force": np.array([0.09, -0.06, -9.5])}, ""),
        ({"attitude": Rotation.from_euler("ZYX", (1.0, 0.4, 0.0))}, "pose and IMU are 23 deg apart"),
        ({"attitude": Rotation.from_euler("x", np.pi)}, "pose and IMU are 180 deg apart"),
        ({"order": (0, 1, 2, 3)}, "pose and IMU are"),
        ({"down": -1.1}, "pose is +1.10 m above the floor"),
        ({"down": 12.0}, "pose is -12.00 m above the floor"),
    ],
)
def test_a_pose_is_judged(poses, fault):
    found = judged(**poses)
    assert found.startswith(fault)
    assert bool(found) == bool(fault)


def test_a_tilted_vehicle_with_the_same_tilt_in_its_pose_is_good():
    attitude = Rotation.from_euler("ZYX", (0.3, 0.25, -0.2))
    assert judged(attitude=attitude, force=attitude.inv().apply([0.0, 0.0, -9.8])) == ""
    assert "apart" in judged(attitude=attitude, force=attitude.apply([0.0, 0.0, -9.8])), "world to body"


def test_a_pause_counts_until_it_is_old():
    health = PoseHealth(PoseHealthConfig())
    for k in range(200):
        now_ns = k * 10**7 + (3 * 10**9 if k >= 100 else 0)
        health.add(0.0, (1.0, 0.0, 0.0, 0.0), now_ns, REST)
        if k == 111:
            assert health.fault.startswith("pose at")
    assert health.fault == ""
