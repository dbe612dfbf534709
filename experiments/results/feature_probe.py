"""Measures whether features distinguish flight regimes: silhouette, a linear probe, t-SNE and PCA.

"before" is the network that the trainer started from, "after" the last version it sent, "rbf" the radial basis
functions of the controller mrac, and "rbf_same" the same number of the same width with the network's inputs
only (motor thrusts alone may identify a regime). All are evaluated on the same flight. The time of a sample gives its
regime. The probe is trained and tested on separate blocks of time, so that it cannot profit from neighbouring samples.
"""

import io
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from configs.loader import ConfigError, fill, read_tree
from configs.parts import read_part
from experiments.campaigns.runner import experience_path
from experiments.results.campaign_data import CampaignData, Trace
from experiments.results.figure_style import legend_below, new_figure
from experiments.results.statistics import median
from experiments.results.tables import Table
from onboard.control.features import Features, NetworkFeatures, RadialFeatures
from onboard.control.laws.adaptive import AdaptiveConfig
from protocol.conventions import Array
from protocol.feature_codec import decode_feature_set
from protocol.feature_config import FeatureInputs, FeaturesConfig
from protocol.feature_set import ChannelFeatures, FeatureSet
from protocol.geometry import roll_pitch_yaw
from protocol.signals import CHANNELS, SIGNAL_NAMES

SAMPLES_MAX: Final = 700
ROUND_S: Final = 6.0
"""One lap of the figure-8 of the scenarios. A fold leaves out one lap of every regime, so it contains all places."""
PROBE_SEED: Final = 7
KIND_LABELS: Final = {
    "before": "before training",
    "after": "after training",
    "rbf_same": "radial basis functions of the same inputs",
    "rbf": "radial basis functions of mrac",
}
DRAWN: Final = ("before", "after", "rbf_same")
"""Kinds with the same inputs."""


@dataclass(frozen=True)
class Regimes:
    """Samples of one flight with their regimes."""

    signals: Array
    """[n, SIGNAL_COUNT]."""
    regime: Array
    """[n], number of the regime."""
    round: Array
    """[n], number of the lap within the regime."""
    names: tuple[str, ...]


def regimes_of(trace: Trace, spans: dict[str, tuple[float, float]], round_s: float = ROUND_S) -> Regimes:
    """Return the samples of a trace within whole laps of the spans (s of flight time), thinned to about SAMPLES_MAX."""
    time = trace.time_s
    regime, number_of_round = np.full(time.size, -1), np.zeros(time.size)
    for number, (start, end) in enumerate(spans.values()):
        rounds = int((end - start) / round_s + 1e-6)
        chosen = (time >= start) & (time < start + rounds * round_s)
        regime[chosen] = number
        number_of_round[chosen] = np.minimum(np.floor((time[chosen] - start) / round_s), rounds - 1)
    rows = np.flatnonzero((regime >= 0) & (trace["truth_airborne"] > 0.5))
    rows = rows[:: max(rows.size // SAMPLES_MAX, 1)]
    return Regimes(signals_of(trace)[rows], regime[rows], number_of_round[rows], tuple(spans))


def signals_of(trace: Trace) -> Array:
    """Return the signal vectors of a trace, [n, SIGNAL_COUNT]."""
    quaternion = trace.vector("tick_quaternion", "wxyz")
    velocity, u = trace.vector("tick_velocity", "ned"), quaternion[:, 1:]
    twice = 2.0 * np.cross(u, velocity)
    body = velocity - quaternion[:, :1] * twice + np.cross(u, twice)  # R' v
    columns = {f"position_{axis}": trace[f"tick_position_{axis}"] for axis in "ned"}
    columns |= {f"velocity_{axis}": trace[f"tick_velocity_{axis}"] for axis in "ned"}
    columns |= dict(zip(("roll", "pitch", "yaw"), roll_pitch_yaw(quaternion).T, strict=True))
    columns |= {f"rate_{axis}": trace[f"tick_rates_{axis}"] for axis in "pqr"}
    columns |= {f"body_velocity_{axis}": body[:, place] for place, axis in enumerate("xyz")}
    columns |= {f"motor_thrust_{motor}": trace[f"tick_motor_thrust_{motor}"] for motor in "1234"}
    columns |= {"battery_voltage": trace["tick_battery"], "vibration": trace["tick_vibration"]}
    return np.stack([columns[name] for name in SIGNAL_NAMES], axis=1)


@dataclass(frozen=True)
class LearntFlight:
    """The network of a flight: how it started, and what was learnt."""

    features: FeaturesConfig
    seed: int
    """Of the offboard side."""
    learnt: bytes


def feature_maps(flight: LearntFlight, channel: int) -> dict[str, Features]:
    """Return the features to compare, for channel 0 (position) or 1 (attitude).

    Raises
    ------
    ConfigError
        If the flight sent no features of that channel.
    """
    from offboard.training.network import InputPlan, feature_set, initial_state

    start = initial_state(flight.features.trained, np.random.default_rng([flight.seed, 1]))
    before = feature_set(start, InputPlan.of(flight.features.trained), 1, 0, 0)
    with np.load(io.BytesIO(flight.learnt), allow_pickle=False) as archive:
        if "features" not in archive.files:
            raise ConfigError("the flight sent no features to probe")
        after = decode_feature_set(archive["features"].tobytes())
    first, last = (_of(features, channel) for features in (before, after))
    radial, width = _rbf(flight.features.untrained, CHANNELS[channel])
    same = RadialFeatures(first.inputs, first.offset, first.scale, width)
    return {"before": NetworkFeatures(first), "after": NetworkFeatures(last), "rbf_same": same, "rbf": radial}


def _of(features: FeatureSet, channel: int) -> ChannelFeatures:
    one = features.by_channel[channel]
    if one is None:
        raise ConfigError(f"the flight has no features of the {CHANNELS[channel]} channel")
    return one


def _rbf(inputs: FeatureInputs, channel: str) -> tuple[RadialFeatures, float]:
    """Return the radial basis functions of mrac, and their width in scaled inputs."""
    augmentation = read_part("controllers", "mrac")["settings"][channel]["augmentation"]
    width = fill(AdaptiveConfig, augmentation, "mrac").rbf_width
    names = inputs.inputs(channel)
    return RadialFeatures(names, *inputs.offset_and_scale(names), width), width


def phi(features: Features, signals: Array) -> Array:
    """Return the standardised features of signal vectors, without the constant, [n, k - 1]."""
    values = features.evaluate(features.select(signals.T))[:-1].T
    standard: Array = (values - values.mean(axis=0)) / (values.std(axis=0) + 1e-9)
    return standard


def probe_accuracy(values: Array, samples: Regimes) -> float:
    """Return the balanced accuracy of a linear probe (multinomial logistic regression), cross-validated lap by lap.

    Each fold leaves out the same lap of every regime, and all regimes have the same weight. So the training set has
    the same number of samples of each regime at every place. Otherwise features that depend only on the place would
    score far below chance: the probe would guess the regime with more samples left there, never the one left out.
    """
    from sklearn.linear_model import LogisticRegression
    from sklearn.metrics import balanced_accuracy_score

    predicted = np.full(samples.regime.size, -1)
    folds = min(int(samples.round[samples.regime == regime].max()) + 1 for regime in np.unique(samples.regime))
    for number in range(folds):
        test = samples.round % folds == number
        probe = LogisticRegression(max_iter=2000, C=1.0, class_weight="balanced", random_state=PROBE_SEED)
        probe.fit(values[~test], samples.regime[~test])
        predicted[test] = probe.predict(values[test])
    return float(balanced_accuracy_score(samples.regime, predicted))


def silhouette(values: Array, samples: Regimes) -> float:
    """Return the mean silhouette of the regimes in feature space (-1 to 1)."""
    from sklearn.metrics import silhouette_score

    return float(silhouette_score(values, samples.regime))


@lru_cache(maxsize=4)
def _flights(data_folder: Path, keys: tuple[str, ...]) -> tuple[LearntFlight, ...]:
    found = []
    for key in keys:
        stem = key.replace("/", "__")
        flight = read_tree(data_folder / "traces" / f"{stem}.yaml")
        features = fill(FeaturesConfig, flight["features"], stem, "features.")
        found.append(LearntFlight(features, flight["offboard"]["seed"], experience_path(data_folder, key).read_bytes()))
    return tuple(found)


def probe_table(data: CampaignData, case: str, spans: dict[str, tuple[float, float]]) -> Table:
    """Return silhouette and probe accuracy over the flights of a case, as medians with intervals."""
    traces = [trace for group in data.select(case, "dmrac") for trace in data.traces(group)]
    flights = _flights(data.folder, tuple(trace.row["key"] for trace in traces))
    sampled = [regimes_of(trace, spans) for trace in traces]
    rows = []
    for channel, name in enumerate(CHANNELS):
        maps = [feature_maps(flight, channel) for flight in flights]
        for kind, label in KIND_LABELS.items():
            inputs = maps[0][kind].select(sampled[0].signals[0]).shape[0]
            scores: list[tuple[float, float]] = []
            for features, samples in zip(maps, sampled, strict=True):
                values = phi(features[kind], samples.signals)
                scores.append((silhouette(values, samples), probe_accuracy(values, samples)))
            cells = [_cell([score[which] for score in scores]) for which in (0, 1)]
            rows.append((name, label, str(inputs), str(len(scores)), *cells))
    chance = f"linear probe, balanced accuracy (chance {1 / len(spans):.2f})"
    header = ("channel", "features", "inputs", "flights", "silhouette", chance)
    return Table(f"How well features distinguish {', '.join(spans)}", header, tuple(rows))


def _cell(values: list[float]) -> str:
    from experiments.results.wording import show

    return show(median(values, np.random.default_rng(PROBE_SEED)), 2)


def feature_figure(data: CampaignData, case: str, spans: dict[str, tuple[float, float]], channel: int) -> Any:
    """Draw t-SNE and PCA in three dimensions, before and after training and for radial functions; one flight."""
    from sklearn.decomposition import PCA
    from sklearn.manifold import TSNE

    trace = next(trace for group in data.select(case, "dmrac") for trace in data.traces(group))
    flight = _flights(data.folder, (trace.row["key"],))[0]
    samples = regimes_of(trace, spans)
    maps = feature_maps(flight, channel)
    figure = new_figure(7.4, 10.5)
    panels = []
    for column, kind in enumerate(DRAWN):
        values = phi(maps[kind], samples.signals)
        pca = PCA(3, random_state=PROBE_SEED).fit(values)
        kept = 100.0 * float(pca.explained_variance_ratio_.sum())
        tsne = TSNE(3, perplexity=30.0, init="pca", random_state=PROBE_SEED, n_jobs=1).fit_transform(values)
        for row, (points, name) in enumerate(
            ((tsne, "t-SNE"), (pca.transform(values), f"PCA ({kept:.0f} % of variance)"))
        ):
            panel = figure.add_subplot(2, 3, 3 * row + column + 1, projection="3d")
            _scatter(panel, points, samples)
            label = KIND_LABELS[kind].replace(" of the same", "\nof the same") if row == 0 else ""
            panel.set_title(f"{label}\n{name}".strip(), fontsize=10)
            panels.append(panel)
    legend_below(figure, panels[:1])
    return figure


_LOOKS: Final = (
    ("#56b4e9", "o"),
    ("#009e73", "^"),
    ("#000000", "s"),
    ("#d55e00", "P"),
    ("#e69f00", "D"),
    ("#cc79a7", "v"),
)


def _scatter(panel: Any, points: Array, samples: Regimes) -> None:
    for number, name in enumerate(samples.names):
        colour, marker = _LOOKS[number % len(_LOOKS)]
        chosen = points[samples.regime == number]
        panel.scatter(*chosen.T, s=9, c=colour, marker=marker, alpha=0.6, linewidths=0, label=name, depthshade=False)
    for axis in (panel.xaxis, panel.yaxis, panel.zaxis):
        axis.set_ticklabels([])
    panel.set_box_aspect(None, zoom=0.95)
