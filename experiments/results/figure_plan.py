"""Draws the figures of a campaign: the `figures` entries of its file, each a kind and the options of its function."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from configs.loader import ConfigError
from experiments.results import row_figures, sweep_figures, trace_figures
from experiments.results.campaign_data import CampaignData
from experiments.results.figure_style import drawn_for, save
from experiments.results.tables import Table, has_bounds
from experiments.results.thrust_limit import limit_table
from experiments.results.wording import metric_name
from runtime.files import write_atomically

Drawer = Callable[..., Any]


@dataclass(frozen=True)
class Picture:
    """A drawn figure."""

    name: str
    caption: str
    png: Path


KEPT: Final = "not redrawn, its traces are not in this folder"
COMPARED: Final = "{metric}: median over survivors with 95 % bootstrap interval; dots: single flights."
MARKS: Final = "grey: onsets of the fault; dotted: vehicle lost."
BAND: Final = f"Mean and standard deviation over the seeds with traces; {MARKS}"
ONE_SEED: Final = f"The first seed's flight, as every seed flies another path; {MARKS}"
KINDS: Final[dict[str, tuple[Drawer, str]]] = {
    "survival": (sweep_figures.survival, "Survival with 95 % Wilson intervals; lines: logistic fit to all flights."),
    "sweep": (sweep_figures.sweep_metric, "{metric}: median over survivors with 95 % bootstrap interval."),
    "compare": (row_figures.compare, COMPARED),
    "cases": (row_figures.compare, COMPARED),
    "laps": (row_figures.laps, "Position RMSE lap by lap, {case}: median and the middle half of the seeds."),
    "age": (
        row_figures.age,
        "Settled RMSE against the age of the features; crosses: flights that never activated a version.",
    ),
    "swaps": (
        row_figures.swaps,
        "Jump of nu_ad at a swap, relative to the limit above which a swap is refused.",
    ),
    "bounds": (
        row_figures.bounds,
        "Median live bound on the tracking error against the error, a point for each flight.",
    ),
    "position": (trace_figures.position, "Position, {case}. {band}"),
    "attitude": (trace_figures.attitude, "Roll and pitch, {case}. {band}"),
    "torques": (
        trace_figures.torques,
        "Commands split into feedback, feed-forward and adaptive part, moving average over 0.18 s, {case}.",
    ),
    "path": (trace_figures.path, "Flown path in three dimensions, {case}."),
    "training": (trace_figures.training, "Training, validation and test loss along a flight, {case}."),
    "position_cases": (trace_figures.position_cases, "Distance to the target. " + BAND),
}


def draw_all(data: CampaignData, folder: Path, report: Callable[[str], None]) -> tuple[list[Picture], list[Table]]:
    """Draw the figures that the campaign's file lists; return them and the tables among them.

    A figure whose flights or traces are missing is left out, unless it was drawn before for the same entry. Both cases
    are reported.

    Raises
    ------
    ConfigError
        If an entry has an unknown kind or an unknown option.
    """
    pictures: list[Picture] = []
    tables: list[Table] = []
    for number, entry in enumerate(data.config.figures):
        options = dict(entry)
        kind = str(options.pop("kind", ""))
        name = f"{data.name}_{number + 1:02d}_{kind}"
        asked = json.dumps(entry, sort_keys=True)
        if kind == "features":
            found = _draw_features(data, folder, name, options, asked, report)
            pictures += found[0]
            tables += found[1]
            continue
        if kind == "thrust_limit":
            tables.append(_called(limit_table, data, number, options))
            continue
        if kind not in KINDS:
            allowed = ", ".join([*KINDS, "features", "thrust_limit"])
            raise ConfigError(f"{data.name}: figures.{number}.kind: {kind!r}: allowed are {allowed}")
        drawer, caption = KINDS[kind]
        picture = Picture(name, _caption(data, caption, options), folder / f"{name}.png")
        if _has_flights(data, kind, options):
            save(_called(drawer, data, number, options), folder, name, asked)
            report(name)
        elif drawn_for(picture.png) == asked:
            report(f"{name}: {KEPT}")
        else:
            report(f"{name}: left out, its flights are missing or have no traces")
            continue
        pictures.append(picture)
    return pictures, tables


def _called(drawer: Drawer, data: CampaignData, number: int, options: dict[str, Any]) -> Any:
    try:
        return drawer(data, **options)
    except TypeError as error:
        raise ConfigError(f"{data.name}: figures.{number}: {error}") from None


def _caption(data: CampaignData, caption: str, options: dict[str, Any]) -> str:
    case = data.label(options["case"]) if "case" in options else ""
    at = ", ".join(f"{key} {value}" for key, value in options.get("point", {}).items())
    band = BAND if "case" in options and data.one_path(options["case"]) else ONE_SEED
    conditions = f"{case}, {at}" if at else case
    words = caption.format(metric=metric_name(options.get("metric", "")), case=conditions, band=band)
    return words[0].upper() + words[1:]


def _has_flights(data: CampaignData, kind: str, options: dict[str, Any]) -> bool:
    cases = options.get("cases") or [options.get("case")]
    controllers = options.get("controllers") or [None]
    groups = [
        group for case in cases for name in controllers for group in data.select(case, name, options.get("point"))
    ]
    if kind in ("position", "attitude", "torques", "path", "position_cases"):
        return any(data.traces(group) for group in groups)
    if kind == "training":
        return any(trace["epochs"].size for group in groups for trace in data.traces(group)[:1])
    metric = options.get("metric")
    if kind == "swaps":
        return any(row["swaps"] > 0 for row in data.rows if row["controller"] == "dmrac")
    if kind == "bounds":
        return has_bounds(data.rows)
    return any(metric is None or group.values(metric) for group in groups)


def _draw_features(
    data: CampaignData, folder: Path, name: str, options: dict[str, Any], asked: str, report: Callable[[str], None]
) -> tuple[list[Picture], list[Table]]:
    from experiments.results.feature_probe import feature_figure, probe_table
    from protocol.signals import CHANNELS

    case = options["case"]
    spans = {regime: (float(start), float(end)) for regime, (start, end) in options["regimes"].items()}
    caption = f"channel's features in {', '.join(spans)}: t-SNE and PCA."
    pictures = [
        Picture(f"{name}_{words}", f"The {words} {caption}", folder / f"{name}_{words}.png") for words in CHANNELS
    ]
    numbers = folder / f"{name}.json"
    traces = [trace for group in data.select(case, "dmrac") for trace in data.traces(group)]
    if traces:
        for channel, picture in enumerate(pictures):
            save(feature_figure(data, case, spans, channel), folder, picture.name, asked)
            report(picture.name)
        table = probe_table(data, case, spans)
        write_atomically(numbers, json.dumps(asdict(table), ensure_ascii=False, indent=1).encode())
        return pictures, [table]
    if numbers.exists() and all(drawn_for(picture.png) == asked for picture in pictures):
        report(f"{name}: {KEPT}")
        cells = json.loads(numbers.read_bytes())
        rows = tuple(tuple(row) for row in cells["rows"])
        return pictures, [Table(cells["caption"], tuple(cells["header"]), rows)]
    report(f"{name}: left out, its flights have no traces")
    return [], []
