"""A campaign that nobody flew: its outcome is known."""

import json
from typing import Any

import numpy as np

from experiments.campaigns.flight_jobs import FlightJob
from experiments.campaigns.flight_row import empty_row
from experiments.campaigns.worker import TRACE_COLUMNS, TRUTH_COLUMNS

TEXT = """
title: Made up
description: Nothing was flown.
controllers: [pid, mrac, dmrac]
compare_to: pid
seeds: {first: 1000, count: 12}
traces: 2
metrics: [first_lap_rmse_m, settled_rmse_m]
cases: [{name: chip, label: a chip, scenario: rotor_chip}]
sweeps: [{name: factor, label: thrust left, path: vehicle.disturbances.0.thrust_factor, values: [0.6, 0.7, 0.9]}]
targets:
  - {label: dmrac / mrac, ours: {case: chip, controller: dmrac, point: {factor: 0.9}},
     theirs: {case: chip, controller: mrac, point: {factor: 0.9}}, metric: settled_rmse_m, at_most: 0.75}
figures:
  - {kind: survival, sweep: factor}
  - {kind: sweep, sweep: factor, metric: settled_rmse_m}
  - {kind: compare, metric: settled_rmse_m}
  - {kind: cases, metric: settled_rmse_m}
  - {kind: laps, case: chip}
  - {kind: age, controllers: [dmrac]}
  - {kind: swaps}
  - {kind: bounds}
  - {kind: position, case: chip, point: {factor: 0.7}, controllers: [pid, dmrac]}
  - {kind: attitude, case: chip, point: {factor: 0.7}, controllers: [pid, dmrac]}
  - {kind: torques, case: chip, point: {factor: 0.7}, controllers: [pid, dmrac]}
  - {kind: path, case: chip, point: {factor: 0.9}, controllers: [dmrac]}
  - {kind: training, case: chip, controllers: [dmrac]}
  - {kind: position_cases, cases: [chip], controllers: [dmrac]}
"""
SURVIVES = {"pid": (0.1, 0.5, 1.0), "mrac": (0.1, 0.6, 1.0), "dmrac": (0.0, 0.0, 1.0)}
RMSE = {"pid": 0.10, "mrac": 0.05, "dmrac": 0.02}


def made_up_row(job: FlightJob) -> dict[str, Any]:
    rng = np.random.default_rng([job.seed, 5])
    luck, spread = rng.random(), float(np.exp(rng.normal(0.0, 0.5)))
    factor = dict(job.point)["factor"]
    alive = luck < SURVIVES[job.controller][(0.6, 0.7, 0.9).index(factor)]
    error = RMSE[job.controller] * spread
    return empty_row() | {
        "key": job.key,
        "case": job.case,
        "controller": job.controller,
        "seed": job.seed,
        "point": json.dumps(dict(job.point)),
        "survived": alive,
        "crash_reason": "" if alive else "hit the floor",
        "settled_rmse_m": error,
        "first_lap_rmse_m": 1.5 * error,
        "lap_rmse_m": [1.5 * error, error, error],
        "swaps": 3,
        "feature_age_median_s": spread,
        "position_swap_jump_max_m_s2": 0.5 * spread,
        "attitude_swap_jump_max_rad_s2": 5.0 * spread,
        **{f"{channel}_median_{unit}": size * spread
           for channel, unit, size in (("position_bound", "m", 0.03), ("position_error", "m", 0.01),
                                       ("attitude_bound", "rad", 0.03), ("attitude_error", "rad", 0.01))},
        "position_bound_coverage": 1.0 if job.seed % 2 else 0.99,
        "attitude_bound_coverage": 1.0,
    }  # fmt: skip


def made_up_trace() -> bytes:
    import io

    time = np.arange(0.0, 20.0, 0.02)
    arrays: dict[str, Any] = {f"tick_{name}": np.sin(time) for name in TRACE_COLUMNS}
    arrays |= {f"truth_{name}": np.sin(time) + 0.02 for name in TRUTH_COLUMNS}
    arrays |= {"tick_mode": np.full(time.size, 4.0), "truth_airborne": np.ones(time.size), "time_s": time}
    for name in ("quaternion", "commanded_quaternion"):
        arrays |= {f"tick_{name}_w": np.cos(0.1 * np.sin(time)), f"tick_{name}_x": np.sin(0.1 * np.sin(time))}
        arrays |= {f"tick_{name}_{axis}": np.zeros(time.size) for axis in "yz"}
    arrays |= {"onsets_s": np.array([8.0]), "epoch_time_s": np.arange(5.0), "epochs": np.full((5, 8), 0.1)}
    out = io.BytesIO()
    np.savez(out, allow_pickle=False, **arrays)
    return out.getvalue()
