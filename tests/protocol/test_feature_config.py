"""The `features` section: one for both processes, and a digest that tells two sections apart."""

import pytest

from configs.flight_tree import FORMER_PATHS, Choices
from configs.loader import CONFIG_DIRECTORY, ConfigError, fill, load, read_tree, set_path
from experiments.flights.scenario import resolve
from protocol import feature_config
from protocol.feature_config import FeaturesConfig, feature_digest, with_features
from protocol.messages import LAYOUT_BYTES

FEATURES = load(FeaturesConfig, CONFIG_DIRECTORY / "features.yaml")


def with_value(assignment: str) -> FeaturesConfig:
    return fill(FeaturesConfig, set_path(read_tree(CONFIG_DIRECTORY / "features.yaml"), assignment), "test")


def test_both_sides_hold_the_same_section() -> None:
    flight = resolve("hover", Choices(assignments=("features.trained.count=12", "features.untrained.hidden=[8]")))
    assert flight.features == flight.onboard.features == flight.offboard.features
    assert (flight.features.trained.count, flight.features.untrained.hidden) == (12, (8,))


def test_a_controllers_file_may_overrule_the_section() -> None:
    paper, ours = (resolve("hover", Choices(controller)).features for controller in ("paper_mrac", "mrac"))
    assert ours == FEATURES
    assert paper.untrained.attitude_inputs[:2] == ("roll", "pitch")
    assert (
        paper.untrained.model_copy(update={"attitude_inputs": ours.untrained.attitude_inputs, "start": "constant"})
        == ours.untrained
    )


@pytest.mark.parametrize(
    ("former", "present"),
    [("offboard.network.features=8", "trained.count"), ("offboard.network.dropout=0.25", "trained.dropout")],
)
def test_the_paths_of_earlier_campaigns_still_work(former: str, present: str) -> None:
    assert former.startswith(tuple(FORMER_PATHS))
    group, _, key = present.partition(".")
    value = getattr(getattr(resolve("hover", Choices(assignments=(former,))).features, group), key)
    assert value == float(former.partition("=")[2])


@pytest.mark.parametrize(
    ("assignment", "said"),
    [
        ("trained.position_inputs=[altitude]", r"features\.trained: unknown signal 'altitude'; allowed are position_n"),
        ("untrained.hidden=[129]", r"features\.untrained: hidden: widths from 1 to 128"),
        ("untrained.position_inputs=[vibration]", r"features\.untrained: scales: missing \['vibration'\]"),
        ("trained.channels=[position, position]", r"features\.trained: channels: a channel is named twice"),
    ],
)
def test_what_is_wrong_is_named_once(assignment: str, said: str) -> None:
    with pytest.raises(ConfigError, match=rf"^[^\n]*hover\.yaml --set features\..*{said}[^\n]*$"):
        resolve("hover", Choices(assignments=(f"features.{assignment}",)))
    with pytest.raises(ConfigError, match=r"t: features: missing"):
        with_features({"onboard": {}}, "t")


@pytest.mark.parametrize(
    "assignment",
    [
        "trained.count=19",
        "trained.hidden=[32, 16]",
        "trained.scales.roll.scale=0.21",
        "trained.attitude_inputs=[rate_p]",
        "untrained.count=19",
        "untrained.scales.rate_p.offset=0.1",
        "untrained.position_inputs=[position_n]",
    ],
)
def test_other_inputs_widths_or_scales_have_another_digest(assignment: str) -> None:
    assert feature_digest(with_value(assignment)) != feature_digest(FEATURES)


def test_the_digest_is_that_of_what_both_sides_share(monkeypatch: pytest.MonkeyPatch) -> None:
    digest = feature_digest(FEATURES)
    assert len(digest) == LAYOUT_BYTES
    tree = read_tree(CONFIG_DIRECTORY / "features.yaml")
    tree["trained"]["scales"] = dict(reversed(tree["trained"]["scales"].items()))
    assert feature_digest(fill(FeaturesConfig, tree, "t")) == digest, "the order of the file does not count"
    assert feature_digest(with_value("trained.dropout=0.5")) == digest, "nor what only the training reads"
    monkeypatch.setattr(feature_config, "SIGNALS", {"position_n": "m"})
    assert feature_digest(FEATURES) != digest, "the layout of a sample does"
