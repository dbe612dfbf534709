"""What a memory holds, as text."""

from pathlib import Path
from typing import Any

import numpy as np

from offboard.memory.memory import Condition, Memory, channel_names, last_layers
from offboard.memory.memory_file import FORMAT
from offboard.training.network import InputPlan, feature_set, phi
from protocol.conventions import Array

UNITS = {"position": "m/s^2", "attitude": "rad/s^2"}


def describe(folder: Path, memory: Memory) -> list[str]:
    """The lines that `dmrac memory show` prints."""
    features, prior = memory.features, memory.prior
    names, layers = channel_names(features), last_layers(memory.prior, memory.features, memory.conditions)
    widths = "-".join(str(width) for width in (*features.hidden, features.count))
    lines = [f"{folder}: memory, format {FORMAT}; {len(memory.conditions)} conditions, {memory.samples} samples"]
    if memory.learnt < len(memory.conditions):
        new = len(memory.conditions) - memory.learnt
        lines.append(f"{new} conditions are newer than the inner layers: dmrac learn {folder} --out {folder}")
    for row, name in enumerate(names):
        theta = np.vstack([prior.network.last_layer[row], prior.network.last_bias[row]])
        spread = layers[:, row].std(axis=0)
        lines += [
            f"{name}: {len(features.inputs(name))} inputs, layers {widths}; per weight: theta {_rms(theta):.3g}, "
            f"spread {_rms(spread):.3g}, S0 {prior.variance[row] ** 0.5:.3g}; noise {prior.noise[row] ** 0.5:.3g} "
            f"{UNITS[name]}",
        ]
    lines += [
        "",
        _row("condition", "vehicle", "time", *(f"{name} {what}" for name in names for what in ("RMS", "own", "theta"))),
    ]
    return lines + [_condition_row(memory, one, own) for one, own in zip(memory.conditions, layers, strict=True)]


def as_json(folder: Path, memory: Memory) -> dict[str, Any]:
    """The content of `describe` for programs; one entry per condition."""
    names = channel_names(memory.features)
    layers = last_layers(memory.prior, memory.features, memory.conditions)
    conditions = []
    for condition, own in zip(memory.conditions, layers, strict=True):
        shares = {
            name: dict(zip(("labels_rms", "left_with_own", "left_with_theta"), values, strict=True))
            for name, values in zip(names, _shares(memory, condition, own), strict=True)
        }
        about = {"name": condition.name, "vehicle": condition.vehicle, "duration_s": condition.duration_s}
        conditions.append({**about, "channels": shares})
    return {"folder": str(folder), "format": FORMAT, "samples": memory.samples, "conditions": conditions}


def _condition_row(memory: Memory, condition: Condition, own: Array) -> str:
    values = [f"{value:.2f}" for shares in _shares(memory, condition, own) for value in shares]
    return _row(condition.name, str(condition.vehicle), f"{condition.duration_s:.0f} s", *values)


def _shares(memory: Memory, condition: Condition, own: Array) -> list[tuple[float, float, float]]:
    """RMS of the labels of each channel, and what is left of it with the own last layer and with theta."""
    plan, found = InputPlan.of(memory.features), []
    channels = feature_set(memory.prior.network, plan, 1, 0, 0).channels
    for row, (at, channel) in enumerate(zip(plan.channels, channels, strict=True)):
        Phi, Delta = phi(channel, condition.samples.signals), condition.samples.labels[:, at].astype(np.float64)
        power = _rms(Delta)
        with_own, with_theta = (_rms(Delta - Phi @ W) / max(power, 1e-12) for W in (own[row], channel.last_layer))
        found.append((power, with_own, with_theta))
    return found


def _row(name: str, vehicle: str, time: str, *values: str) -> str:
    return f"{name:<40.40} {vehicle:>7} {time:>6} " + " ".join(f"{value:>14}" for value in values)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.square(values).mean()))
