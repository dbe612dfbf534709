"""Counters, mean scores and calibration of the C core's estimator, under the names of the numpy core's."""

from typing import Any, Final

AIDS: Final = ("flow", "range", "pressure", "pose_position", "pose_attitude")
"""Name of each Aid of estimation/events.h in counts and scores."""


def counts(estimator: Any) -> dict[str, int]:
    """What `Estimator.counts` of the numpy core holds: only what has happened."""
    corrections, poses = estimator.corrections, estimator.poses
    named = {"imu_gap": estimator.imu_gaps, "imu_out_of_order": estimator.imu_out_of_order}
    named |= {"pose_out_of_order": poses.out_of_order, "pose_wrong_time": poses.wrong_time}
    named |= {"pose_used": poses.used, "pose_refused": poses.refused, "pose_jump": poses.jumps}
    named |= {"pose_implausible": poses.implausible, "pose_drift": poses.drifts}
    named |= {"pose_attitude_refused": poses.attitude_refused}
    for index, aid in enumerate(AIDS):
        for what in ("used", "refused", "recovered"):
            named.setdefault(f"{aid}_{what}", getattr(corrections, what)[index])
    return {name: count for name, count in named.items() if count}


def mean_scores(estimator: Any) -> dict[str, float]:
    """What `Estimator.mean_scores` of the numpy core gives."""
    of = estimator.corrections
    return {aid: of.score_sums[i] / of.score_counts[i] for i, aid in enumerate(AIDS) if of.score_counts[i]}


def calibration(core: Any, bench: Any) -> dict[str, Any]:
    """What `BenchCalibration.summary` of the numpy core gives."""
    found = {"accepted": bench.count, "movements": bench.movements}
    if not bench.has_accepted:
        return found
    accepted = bench.accepted
    return {
        **found,
        "gyro_bias_rad_s": list(accepted.rate),
        "accelerometer_along_gravity_m_s2": core.calibration_along_gravity(accepted),
        "seconds": accepted.seconds,
    }
