"""The layout for Foxglove that comes with an exported flight: the vehicle in 3-D, and curves beside it."""

from typing import Final

from foxglove.layouts import (
    BaseRendererSceneUpdateTopicSettings,
    Layout,
    PlotConfig,
    PlotPanel,
    PlotSeries,
    SplitContainer,
    SplitItem,
    ThreeDeeConfig,
    ThreeDeePanel,
)

from flight_log.ros_messages import VEHICLE, WORLD

CURVES: Final[dict[str, tuple[tuple[str, str], ...]]] = {
    "tracking error [m]": (
        ("north", "/onboard/tick.position_error_n"),
        ("east", "/onboard/tick.position_error_e"),
        ("down", "/onboard/tick.position_error_d"),
    ),
    "nu_ad, position channel [m/s²]": (
        ("north", "/onboard/tick.position_adaptive_n"),
        ("east", "/onboard/tick.position_adaptive_e"),
        ("down", "/onboard/tick.position_adaptive_d"),
    ),
    "motors [share of maximum thrust]": tuple((f"motor {i + 1}", f"/actuators.normalized[{i}]") for i in range(4)),
    "features": (("version in use", "/onboard/tick.feature_version"), ("age [s]", "/onboard/tick.feature_age")),
}
"""Title of a plot -> label and message path of each curve."""


def layout() -> Layout:
    """The layout."""
    plots = [
        SplitItem(content=PlotPanel(title=title, config=PlotConfig(paths=[_series(*one) for one in curves])))
        for title, curves in CURVES.items()
    ]
    items = [
        SplitItem(proportion=1.4, content=_room()),
        SplitItem(content=SplitContainer(direction="column", items=plots)),
    ]
    return Layout(content=SplitContainer(direction="row", items=items))


def _series(label: str, path: str) -> PlotSeries:
    return PlotSeries(label=label, value=path, timestamp_method="receiveTime")


def _room() -> ThreeDeePanel:
    scene = {topic: BaseRendererSceneUpdateTopicSettings(visible=True) for topic in ("/vehicle/scene", "/paths")}
    return ThreeDeePanel(
        title="flight",
        config=ThreeDeeConfig(topics=dict(scene), fixed_frame=WORLD, follow_tf=VEHICLE, follow_mode="follow-position"),
    )
