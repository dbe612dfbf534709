"""Names of metrics and formatting of estimates, the same in tables, sentences and figures."""

import math
from typing import Final

from experiments.results.statistics import Estimate

METRIC_NAMES = {
    "position_rmse_m": "position RMSE, whole path [m]",
    "attitude_rmse_rad": "attitude RMSE [rad]",
    "first_lap_rmse_m": "position RMSE, first lap [m]",
    "settled_rmse_m": "position RMSE, settled [m]",
    "before_onset_rmse_m": "position RMSE before the fault [m]",
    "after_onset_rmse_m": "position RMSE, first 4 s after the onset [m]",
    "settled_after_onset_rmse_m": "position RMSE from 10 s after the onset [m]",
    "recovery_s": "recovery time [s]",
    "worst_error_m": "largest distance to the target [m]",
    "feature_age_median_s": "median age of the features [s]",
    "position_swap_jump_max_m_s2": "largest jump of nu_ad at a swap [m/s²]",
    "attitude_swap_jump_max_rad_s2": "largest jump of nu_ad at a swap [rad/s²]",
    "down_bytes_s": "bytes per second down",
    "up_bytes_s": "bytes per second up",
    "position_bound_median_m": "median live bound on the position error [m]",
    "position_error_median_m": "median position error [m]",
    "position_bound_coverage": "share of ticks with a position error within the live bound",
    "attitude_bound_median_rad": "median live bound on the attitude error [rad]",
    "attitude_error_median_rad": "median attitude error [rad]",
    "attitude_bound_coverage": "share of ticks with an attitude error within the live bound",
}
BOUND_UNITS: Final = (("position", "m", "mm", 1e3), ("attitude", "rad", "deg", math.degrees(1.0)))
"""Channel, unit in the columns of its live bound, unit shown, and the factor between them."""


def metric_name(metric: str) -> str:
    """Return a metric in words, with its unit."""
    return METRIC_NAMES.get(metric, metric.replace("_", " "))


def show(estimate: Estimate, digits: int = 3, percent: bool = False) -> str:
    """Return `value [low, high]`, or a dash if there is no value."""
    if not math.isfinite(estimate.value):
        return "–"
    if percent:
        return f"{100 * estimate.value:.0f} % [{100 * estimate.low:.0f}, {100 * estimate.high:.0f}]"
    if not math.isfinite(estimate.low) and not math.isfinite(estimate.high):
        return f"{estimate.value:.{digits}f}"
    return f"{estimate.value:.{digits}f} [{estimate.low:.{digits}f}, {estimate.high:.{digits}f}]"


def counted(count: int, thing: str) -> str:
    """Return `1 pair`, `2 pairs`."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"
