"""Constants of the Python core that the C core needs as well. Their one owner is the Python module."""

from collections.abc import Iterator
from enum import Enum
from importlib import import_module
from typing import Any, Final

from pydantic import BaseModel

from onboard.control.feature_swap import SwapConfig
from onboard.control.laws.lap_table import LapConfig
from onboard.flight.modes import TRANSITIONS, Command, Event, FlightMode
from onboard.sampling.sampler import SamplerConfig
from protocol.messages import REFUSALS
from protocol.signals import SIGNAL_NAMES

CONSTANTS: Final[dict[str, tuple[str, ...]]] = {
    "protocol.conventions": ("GRAVITY", "NEVER_NS"),
    "protocol.signals": ("SIGNAL_COUNT",),
    "protocol.feature_set": ("LAYERS_MAX", "WIDTH_MAX"),
    "onboard.control.actuators": ("CATCH_UP_MAX",),
    "onboard.control.demand_limits": ("FALL_MIN_M_S2", "ASTRAY_COSINE", "UPRIGHT_MIN"),
    "onboard.control.features": ("RBF_COUNT", "INPUT_LIMIT"),
    "onboard.control.laws.last_layer": ("PROJECTION_MARGIN", "SQUARE_MAX"),
    "onboard.control.laws.adaptive": ("EPS_1_MEMORY_S",),
    "onboard.control.tracking_bound": (
        "RESIDUAL_FILTER_S=BOUND_RESIDUAL_FILTER_S",
        *("ESTIMATE_SIGMAS", "SPREAD", "OVERSHOOT"),
    ),
    "onboard.flight.guidance": ("RETURN_M_S2",),
    "onboard.flight.supervisor": ("LEVEL_MAX_RAD", "_QUEUE_MAX=COMMAND_QUEUE_MAX", "_PROGRESS_M", "_NOT_READY_NS"),
    "onboard.estimation.state_history": ("LENGTH=HISTORY_LENGTH",),
    "onboard.estimation.error_state_filter": (
        *("POSITION", "VELOCITY", "ATTITUDE", "GYRO_BIAS", "ACCELEROMETER_BIAS", "ERROR_SIZE"),
    ),
    "onboard.estimation.imu_conditioning": (
        *("_CORNER=VIBRATION_CORNER", "_SMOOTHING_S=VIBRATION_SMOOTHING_S", "_FORCE_ERROR_MAX"),
    ),
    "onboard.estimation.stuck_gyro": ("KEPT=GYRO_KEPT", "PER_REPEAT", "REPEATS_MAX=REPEATS_ALLOWED"),
    "onboard.estimation.calibration": ("BLOCK_S=CALIBRATION_BLOCK_S", "LEAST_SAMPLES=CALIBRATION_LEAST_SAMPLES"),
    "onboard.estimation.corrections": ("REFUSED_MIN", "EVENTS_MAX=ESTIMATOR_EVENTS_MAX"),
    "onboard.estimation.pose_fusion": (
        *("FUTURE_NS", "WRONG_FOR_S", "LARGE_TURN_RAD"),
        *("DRIFT_VELOCITY_SIGMA", "DRIFT_HEIGHT_SIGMA", "DRIFT_CLIMB_SIGMA"),
    ),
    "onboard.estimation.pose_trust": (
        *("SLOW_S", "FAST_S", "RANGE_STEP_MAX_M", "PRESSURE_SHARE", "TURN_RATE_RAD_S", "STEP_MAX_S"),
    ),
    "onboard.estimation.estimator": (
        *("AIR_PA_PER_M", "SLOW_AIDS", "PRESSURE_TURN", "COS_TILT_MIN", "RATE_SIGMA", "TURN_SIGMA", "GAP_MAX_S"),
    ),
    "onboard.sampling.signal_vector": ("THRUST_FILTER_S",),
    "protocol.messages": ("SAMPLES_PER_BATCH_MAX",),
    "onboard.sampling.sampler": ("SAMPLE_BYTES", "NETWORK_BYTES", "BATCH_OVERHEAD_BYTES", "_BURST_BYTES"),
}
"""Module, and names there; `OLD=NEW` gives it another name in C. A tuple becomes NAME_0, NAME_1 and so on."""
ENUMERATIONS: Final[dict[str, type[Enum]]] = {"MODE": FlightMode, "EVENT": Event, "COMMAND": Command}
"""Prefix of the members in C, and the enumeration."""


LIMITS: Final[dict[str, tuple[type[BaseModel], str]]] = {
    "RING_MAX": (SwapConfig, "ring_size"),
    "KEPT_SAMPLES_MAX": (SamplerConfig, "kept_samples"),
    "BINS_MAX": (LapConfig, "bins"),
}
"""Sizes of arrays: the largest value that a field of a record may have."""


def _most(model: type[BaseModel], name: str) -> int:
    """The largest value that a field allows."""
    (most,) = (one.le for one in model.model_fields[name].metadata if hasattr(one, "le"))
    return int(most)


def constants() -> Iterator[tuple[str, Any, str]]:
    """Name in C, value and module of each constant."""
    for module, names in CONSTANTS.items():
        for name in names:
            old, _, new = name.partition("=")
            name_in_c, value = (new or old).lstrip("_"), getattr(import_module(module), old)
            if isinstance(value, tuple):
                yield from ((f"{name_in_c}_{index}", one, module) for index, one in enumerate(value))
            else:
                yield name_in_c, value, module
    for name, (model, field) in LIMITS.items():
        yield name, _most(model, field), f"{model.__name__}.{field}"


def literal(value: Any) -> str:
    """The value in C."""
    if isinstance(value, float):
        return f"REAL({value!r})"
    return f"INT64_C({value})" if abs(value) >= 2**31 else f"({value})" if value < 0 else str(value)


def enumerations() -> Iterator[tuple[str, list[str]]]:
    """Name in C and members, in the order of their numbers, from 0."""
    yield "Refusal", [f"REFUSAL_{name.upper() or 'NONE'}" for name in REFUSALS]
    yield "Signal", [f"SIGNAL_{name.upper()}" for name in SIGNAL_NAMES]


def mode_enumerations() -> Iterator[tuple[str, list[str]]]:
    """The same for modes, events and commands."""
    for prefix, one in ENUMERATIONS.items():
        yield one.__name__, [f"{prefix}_{member.name}" for member in one]


def transitions() -> Iterator[tuple[str, list[tuple[str, str]]]]:
    """Each flight mode with its row of the table: events and the modes that follow."""
    for mode in FlightMode:
        yield f"MODE_{mode.name}", [(f"EVENT_{event.name}", f"MODE_{to.name}") for event, to in TRANSITIONS[mode]]
