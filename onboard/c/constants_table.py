"""Constants of the Python core that the C core needs as well. Their one owner is the Python module."""

from collections.abc import Iterator
from enum import Enum
from importlib import import_module
from typing import Any, Final

from pydantic import BaseModel

from onboard.control.feature_swap import SwapConfig
from onboard.control.laws.lap_table import LapConfig
from onboard.flight.modes import AIRBORNE, RESTING, SPINNING, TRANSITIONS, Command, Event, FlightMode
from onboard.sampling.sampler import SamplerConfig
from protocol.messages import REFUSALS
from protocol.signals import SIGNAL_NAMES
from protocol.statistics import REJECTIONS

CONSTANTS: Final[dict[str, tuple[str, ...]]] = {
    "protocol.conventions": ("GRAVITY", "NEVER_NS"),
    "protocol.feature_set": ("LAYERS_MAX", "WIDTH_MAX"),
    "protocol.feature_codec": ("FEATURE_SET_MAX_BYTES", "FORMAT=FEATURE_SET_FORMAT", "_NAME_MAX_BYTES"),
    "onboard.control.actuators": ("CATCH_UP_MAX",),
    "onboard.flight.adaptation_gate": ("ADAPT_HEIGHT_M", "ADAPT_CLIMB_M", "VELOCITY_AID_MAX_S"),
    "onboard.control.cascade": (*("YAW_ERROR_MAX_RAD", "MODEL_ERROR_MAX_RAD", "MODEL_GAP_MAX_S"),),
    "onboard.control.command_motion": ("COMMAND_JUMP_RAD",),
    "onboard.control.demand_limits": ("FALL_MIN_M_S2", "ASTRAY_COSINE", "UPRIGHT_MIN"),
    "onboard.control.features": ("RBF_COUNT", "INPUT_LIMIT"),
    "onboard.control.laws.last_layer": ("PROJECTION_MARGIN", "SQUARE_MAX"),
    "onboard.control.laws.adaptive": ("EPS_1_MEMORY_S",),
    "onboard.control.laws.forecast_skill": ("SLOW_S=SKILL_SLOW_S", "MEMORY_S=SKILL_MEMORY_S"),
    "onboard.control.laws.kalman_state": ("MULTIPLIER_STEPS", "MULTIPLIER_TOLERANCE"),
    "onboard.control.laws.slope_bound": ("PERIOD_TICKS=SLOPE_PERIOD_TICKS",),
    "onboard.control.tracking_bound": (
        "RESIDUAL_FILTER_S=BOUND_RESIDUAL_FILTER_S",
        *("ESTIMATE_SIGMAS", "SPREAD", "OVERSHOOT"),
    ),
    "onboard.control.posterior_swap": (
        *("STATES_PER_PART", "SLOPES_PER_PART", "UPDATES_PER_PART", "SLOPE_STRIDE", "FOLLOWED_MAX"),
    ),
    "onboard.control.version_test": (
        *(
            "BOX_SLOPES_PER_PART",
            "AHEAD_PER_PART",
            "CHECKED_PER_PART",
            "BOX_POINTS",
            "BOX_AXES",
            "PATH_POINTS",
            "STEP_MIN_M",
        ),
    ),
    "onboard.control.watch": ("STRIDE=WATCH_STRIDE",),
    "onboard.control.guard": ("LOSES_S",),
    "onboard.flight.guidance": ("RETURN_M_S2",),
    "onboard.flight.path_turn": ("STEP_S=TURN_STEP_S",),
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
    "onboard.record.tick": ("POSITION_AT=TICK_POSITION_AT", "ATTITUDE_AT=TICK_ATTITUDE_AT"),
    "protocol.messages": (
        *("DATAGRAM_MAX_BYTES", "SAMPLES_PER_BATCH_MAX", "CHUNK_DATA_MAX_BYTES", "CHUNK_COUNT_MAX", "DIGEST_BYTES"),
        *("LAYOUT_BYTES", "ABSOLUTE_VALUE_MAX", "COUNTER_MAX", "VERSION_MAX", "MODES", "APART_MAX_NS"),
    ),
    "protocol.authentication": ("MAC_BYTES", "KEY_MIN_BYTES", "KEY_MAX_BYTES"),
    "protocol.codec": ("PROTOCOL_VERSION", "_FIELDS_MAX"),
    "protocol.session": ("WINDOW=REPLAY_WINDOW", "RETIRED_MAX", "SEQUENCE_JUMP_MAX", "SILENCE_BEFORE_OLDER_NS"),
    "protocol.clock": ("OPEN_REQUESTS_MAX", "SAMPLES_MAX=CLOCK_SAMPLES_MAX", "REQUEST_LIFE_NS", "JUMP_SLACK_NS"),
    "protocol.clock_map": ("WINDOW_NS=CLOCK_WINDOW_NS", "BUCKET_NS=CLOCK_BUCKET_NS", "AHEAD_NS"),
    "protocol.endpoint": (
        *("DATAGRAM_MIN_BYTES", "BODY_MAX_BYTES", "CHALLENGE_PERIOD_NS", "RATE_MAX_HZ", "RATE_BURST"),
        "AHEAD_MAX_NS=PEER_AHEAD_MAX_NS",
    ),
    "onboard.links.loss_rate": ("WINDOW_NS=LOSS_WINDOW_NS", "QUEUEING_NS", "SILENT_NS"),
    "onboard.links.offboard": ("CLOCK_RECORD_PERIOD_NS", "AGE_MAX_MS", "GOOD_ROUND_TRIP_NS", "ROUND_TRIP_TO_SIGMA"),
    "onboard.sampling.sampler": ("SAMPLE_BYTES", "NETWORK_BYTES", "BATCH_OVERHEAD_BYTES", "_BURST_BYTES"),
}
"""Module, and names there; `OLD=NEW` gives it another name in C. A tuple becomes NAME_0, NAME_1 and so on."""
ENUMERATIONS: Final[dict[str, type[Enum]]] = {"MODE": FlightMode, "EVENT": Event, "COMMAND": Command}
"""Prefix of the members in C, and the enumeration."""
MODE_SETS: Final = {"SPINNING": SPINNING, "RESTING": RESTING, "AIRBORNE": AIRBORNE}


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
    if isinstance(value, str):
        return f'"{value}"'
    return f"INT64_C({value})" if abs(value) >= 2**31 else f"({value})" if value < 0 else str(value)


def enumerations() -> Iterator[tuple[str, list[str]]]:
    """Name in C and members, in the order of their numbers, from 0."""
    yield "Refusal", [f"REFUSAL_{name.upper() or 'NONE'}" for name in REFUSALS]
    yield "Rejection", [f"REJECTED_{name.upper() or 'NONE'}" for name in REJECTIONS]
    yield "Signal", [f"SIGNAL_{name.upper()}" for name in SIGNAL_NAMES]


def mode_enumerations() -> Iterator[tuple[str, list[str]]]:
    """The same for modes, events and commands."""
    for prefix, one in ENUMERATIONS.items():
        yield one.__name__, [f"{prefix}_{member.name}" for member in one]


def mode_sets() -> Iterator[tuple[str, list[str]]]:
    """Name in C of each set of modes, and its members."""
    for name, modes in MODE_SETS.items():
        yield f"MODES_{name}", [f"MODE_{mode.name}" for mode in sorted(modes)]


def transitions() -> Iterator[tuple[str, list[tuple[str, str]]]]:
    """Each flight mode with its row of the table: events and the modes that follow."""
    for mode in FlightMode:
        yield f"MODE_{mode.name}", [(f"EVENT_{event.name}", f"MODE_{to.name}") for event, to in TRANSITIONS[mode]]
