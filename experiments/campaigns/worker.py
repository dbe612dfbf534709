"""Flies one job in a worker process and returns a row; a flight that fails gives a row with its error.

The process belongs to a local pool or a Dask cluster. The first flight that trains imports torch.
"""

import io
import os
import resource
import sys
import time
import traceback
from dataclasses import dataclass

import numpy as np

from experiments.campaigns.flight_jobs import FlightJob
from experiments.campaigns.flight_row import LinkBytes, Row, flight_row
from experiments.flights.lockstep_flight import LockstepOutcome, fly_lockstep
from experiments.flights.scenario import FlightConfig
from experiments.memory.law_prior import law_spreads
from experiments.memory.learning import learnt_from_lessons, lesson

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
TRACE_STEP = 4
"""Every TRACE_STEP-th tick is stored: 50 Hz."""
TRACE_COLUMNS = (
    *(f"{kind}_{axis}" for kind in ("position", "target", "velocity") for axis in "ned"),
    *(f"{kind}_{axis}" for kind in ("quaternion", "commanded_quaternion") for axis in "wxyz"),
    *(f"rates_{axis}" for axis in "pqr"),
    *(f"motor_thrust_{motor}" for motor in "1234"),
    *(f"position_{kind}_{axis}" for kind in ("demand", "delivered", "adaptive", "residual") for axis in "ned"),
    *(f"attitude_{kind}_{axis}" for kind in ("demand", "delivered", "adaptive", "residual") for axis in "xyz"),
    *(f"feed_forward_{axis}" for axis in "ned"),
    *(f"position_error_{axis}" for axis in "ned"),
    *(f"position_error_rate_{axis}" for axis in "ned"),
    *("position_tracking_bound", "attitude_tracking_bound", "position_weight_norm", "attitude_weight_norm"),
    *("mode", "path_time", "feature_version", "feature_age", "battery", "vibration"),
)
TRUTH_COLUMNS = (*(f"{kind}_{axis}" for kind in ("position", "wind") for axis in "ned"), "airborne")


@dataclass(frozen=True)
class FlightResult:
    """The answer of a worker."""

    key: str
    row: Row
    trace: bytes | None = None
    """Archive of float32 columns at 50 Hz, and of the training's losses."""
    experience: bytes | None = None
    memory: bytes | None = None
    """The memory that the flight started from, if it was learnt for it."""
    config: str = ""
    """Resolved configuration of a flight whose trace is stored."""


def one_thread_each() -> None:
    """Set the environment of the workers: flights run side by side, so each uses one core."""
    for name in THREAD_VARIABLES:
        os.environ.setdefault(name, "1")


def fly_job(job: FlightJob) -> FlightResult:
    """Fly a job and return its row; an error is recorded in the row."""
    row = job.empty_row()
    started, used = time.perf_counter(), time.process_time()
    trace = experience = memory = None
    config_text = ""
    try:
        config = job.configuration()
        link = LinkBytes()
        spreads = law_spreads(config.onboard.controller.settings)
        memory = learnt_from_lessons(job.lessons, spreads) if job.memory else None
        outcome = fly_lockstep(config, (link,), experience=memory or job.experience, core=job.core)
        row |= flight_row(config, outcome, link)
        trace = pack_trace(config, outcome) if job.keep_trace else None
        config_text = config.to_yaml() if job.keep_trace else ""
        if job.keep_experience:
            experience = lesson(config, outcome.trace) if job.teaches else outcome.learnt
    except Exception as error:
        row["error"] = "".join(traceback.format_exception_only(error)).strip() + " at " + _where(error)
    row["wall_s"] = time.perf_counter() - started
    row["cpu_s"] = time.process_time() - used
    row["worker_peak_mib"] = _peak_mib()
    return FlightResult(job.key, row, trace, experience, memory, config_text)


def _where(error: BaseException) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    return f"{os.path.basename(frames[-1].filename)}:{frames[-1].lineno}" if frames else "an unknown place"


def _peak_mib() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024.0 * 1024.0) if sys.platform == "darwin" else peak / 1024.0


def pack_trace(config: FlightConfig, outcome: LockstepOutcome) -> bytes:
    """Return an archive of the columns that figures need, float32 at 50 Hz, and of the losses of every epoch."""
    trace = outcome.trace
    arrays = {f"tick_{name}": trace.tick[name][::TRACE_STEP].astype(np.float32) for name in TRACE_COLUMNS}
    arrays |= {f"truth_{name}": trace.truth[name][::TRACE_STEP].astype(np.float32) for name in TRUTH_COLUMNS}
    arrays["time_s"] = trace.time_s[::TRACE_STEP].astype(np.float32)
    epochs = [(time_ns, vector) for kind, time_ns, vector in outcome.offboard_records if kind.topic == "offboard/epoch"]
    arrays["epoch_time_s"] = np.array([time_ns * 1e-9 for time_ns, _ in epochs], dtype=np.float32)
    arrays["epochs"] = np.array([vector for _, vector in epochs], dtype=np.float32)
    onsets = [item.onset_s for item in config.vehicle.disturbances if item.onset_s > 0.0]
    arrays["onsets_s"] = np.array(sorted(onsets), dtype=np.float32)
    out = io.BytesIO()
    np.savez_compressed(out, allow_pickle=False, **arrays)
    return out.getvalue()
