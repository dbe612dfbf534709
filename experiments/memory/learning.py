"""Learns a memory from flights' logs and from other memories."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from configs.loader import ConfigError, fill_section, parse_mapping
from experiments.flights.scenario import FlightConfig
from experiments.flights.trace import FlightTrace
from experiments.memory.law_prior import Spreads, default_spreads, law_spreads
from experiments.memory.logged_samples import labelled_samples
from experiments.replays.recorded_flight import CONFIG_NAME
from flight_log.reader import Flight, FlightError, open_flight
from offboard.config import LabelConfig
from offboard.memory.config import MemoryConfig
from offboard.memory.folder import memory_file, open_memory, write_memory
from offboard.memory.memory import Condition, Memory, UnusableMemoryError, thinned, unlearnt
from offboard.memory.memory_file import dump_memory, load_memory, require_fit
from offboard.training.network import InputPlan
from onboard.record.tick import TICK
from protocol.feature_config import FeaturesConfig, TrainedFeatures


class Source(NamedTuple):
    """What one source of a memory gives."""

    path: Path
    features: TrainedFeatures
    conditions: tuple[Condition, ...]
    memory: Memory | None
    """None for a flight."""
    spreads: Spreads | None
    """Of the law that flew, or that the memory was learnt for; None if it had no prior."""


def read_source(path: Path) -> Source:
    """The conditions of a flight's folder or of a memory.

    Raises
    ------
    ConfigError
        If it is neither, or holds no sample to learn from.
    """
    if memory_file(path).is_file():
        memory = open_memory(path)
        return _of_memory(path, memory)
    flight = _opened(path)
    tree, source = _config_tree(flight, path)
    features = fill_section(FeaturesConfig, tree, source, "features").trained
    try:
        ticks = flight[TICK.topic]
        rows = ticks.vector(*TICK.names)
    except KeyError as error:
        raise ConfigError(f"{path}: nothing to learn from: {error.args[0]}") from None
    vehicle = int(tree["offboard"].get("vehicle_id", 1)) if isinstance(tree.get("offboard"), dict) else 1
    name = ", ".join(str(tree.get(key, "")) for key in ("scenario", "controller")) + f", seed {tree.get('seed', '')}"
    samples = labelled_samples(ticks.time_ns, rows, LabelConfig())
    if samples.rows == 0:
        raise ConfigError(f"{path}: no sample above the floor in which the controller could adapt")
    return Source(path, features, (Condition(name, vehicle, thinned(samples)),), None, _flown_spreads(tree))


def _of_memory(path: Path, memory: Memory) -> Source:
    spreads = dict(zip(InputPlan.of(memory.features).channels, memory.prior.variance**0.5, strict=True))
    both = Spreads(*(float(spreads.get(at, one)) for at, one in enumerate(default_spreads())))
    return Source(path, memory.features, memory.conditions, memory, both if memory.learnt else None)


def _flown_spreads(tree: dict[str, Any]) -> Spreads | None:
    """Of the controller in a flight's configuration."""
    place: Any = tree
    for key in ("onboard", "controller", "settings"):
        place = place.get(key) if isinstance(place, dict) else None
    return law_spreads(place) if isinstance(place, dict) else None


def _opened(path: Path) -> Flight:
    try:
        return open_flight(path)
    except FlightError as error:
        raise ConfigError(str(error)) from None


def _config_tree(flight: Flight, path: Path) -> tuple[dict[str, Any], str]:
    """The plain configuration of a flight, of any version of this project, and where it is from."""
    for attachments in flight.attachments.values():
        if CONFIG_NAME in attachments:
            source = f"{path}: {CONFIG_NAME}"
            return parse_mapping(attachments[CONFIG_NAME].decode(), source), source
    raise ConfigError(f"{path}: its logs have no {CONFIG_NAME}, so the inputs of its features are unknown")


def condition_of(config: FlightConfig, trace: FlightTrace) -> Condition:
    """A flight as a condition."""
    time_ns = (trace.time_s * 1e9).round().astype(np.int64)
    samples = labelled_samples(time_ns, trace.tick.rows, LabelConfig())
    name = f"{config.scenario}, {config.controller}, seed {config.seed}"
    return Condition(name, config.offboard.vehicle_id, thinned(samples))


def lesson(config: FlightConfig, trace: FlightTrace) -> bytes:
    """The bytes of a memory that holds this flight alone; nothing is learnt from it yet."""
    return dump_memory(unlearnt(config.features.trained).with_condition(condition_of(config, trace)))


@lru_cache(maxsize=2)
def learnt_from_lessons(lessons: tuple[bytes, ...], spreads: Spreads | None) -> bytes:
    """The bytes of the memory that these memories teach together, with the default settings.

    spreads: of the law that will fly with it; None: it has no prior.
    """
    memories = enumerate(map(load_memory, lessons))
    sources = [_of_memory(Path(f"lesson {number}"), memory)._replace(spreads=spreads) for number, memory in memories]
    return dump_memory(learn_from(sources, MemoryConfig()))


def learn_from(sources: Sequence[Source], config: MemoryConfig) -> Memory:
    """The memory of all conditions of the sources, each once.

    The inner layers of the memory with the most conditions, if there is one, are the start. S0 is that of the last
    source whose law had a prior; without one, that of the controller that memories are made for.

    Raises
    ------
    ConfigError
        If two sources have networks of different inputs or widths, or there are too many conditions.
    """
    from offboard.memory.meta_learning import learn

    memories = [source.memory for source in sources if source.memory is not None and source.memory.learnt]
    start = max(memories, key=lambda memory: memory.learnt, default=None)
    first = sources[0]
    features = first.features if start is None else start.features
    try:
        for source in sources:
            _require_same(source, first)
        conditions = [condition for source in sources for condition in source.conditions]
        spreads = [source.spreads for source in sources if source.spreads is not None]
        return learn(features, conditions, spreads[-1] if spreads else default_spreads(), config, start)
    except UnusableMemoryError as error:
        raise ConfigError(str(error)) from None


def remember(folder: Path, flight: Path) -> str:
    """Learn a flight into the memory in a folder, or begin one with it; return what it holds then, as a line.

    Raises
    ------
    ConfigError
        If the flight has no samples, or its networks are not the memory's.
    """
    known = [read_source(folder)] if memory_file(folder).is_file() else []
    memory = learn_from([*known, read_source(flight)], MemoryConfig())
    write_memory(folder, memory)
    return f"{folder}: {len(memory.conditions)} conditions, {memory.samples} samples"


def _require_same(source: Source, first: Source) -> None:
    try:
        require_fit(source.features, first.features)
    except UnusableMemoryError as error:
        raise ConfigError(f"{source.path}: other networks than those of {first.path}: {error}") from None
