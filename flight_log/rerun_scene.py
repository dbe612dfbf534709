"""A scene as a Rerun recording, with its layout. Needs the `viz` extra."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from flight_log.scene import (
    ARROW_COLOURS,
    ARROW_SCALE,
    GROUPS,
    ROTORS,
    TABS,
    THRUST_M_PER_N,
    Curve,
    Motion,
    Scene,
)

APPLICATION: Final = "async-dmrac"
TIMELINE: Final = "flight"
CURVE_COLOURS: Final = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0), (86, 180, 233))
REFERENCE_COLOURS: Final = ((150, 150, 150), (180, 180, 180), (120, 120, 120))
PATH_POINTS_MAX: Final = 5000
TRAIL_S: Final = 4.0
TRAIL_COLOUR: Final = (0, 114, 178)
TARGET_COLOUR: Final = (170, 170, 170)
THRUST_COLOUR: Final = (240, 200, 60)


def save_recording(scene: Scene, path: Path, name: str) -> None:
    """Write the scene to an .rrd file. Raises OSError."""
    recording = new_recording(name)
    path.touch()  # raises OSError, where the library only warns
    recording.save(path, default_blueprint=blueprint(scene.groups, _span_s(scene)))
    log_static(recording, scene)
    log_scene(recording, scene)
    log_paths(recording, scene)
    recording.flush()
    recording.disconnect()


def _span_s(scene: Scene) -> tuple[float, float] | None:
    """From t = 0 to the last point of the curves, s."""
    ends_ns = [int(curve.time_ns[-1]) for curve in scene.curves if len(curve.time_ns)]
    return (0.0, (max(ends_ns) - scene.start_ns) * 1e-9) if ends_ns else None


def new_recording(name: str) -> rr.RecordingStream:
    """An empty recording."""
    return rr.RecordingStream(APPLICATION, recording_id=name, send_properties=False)


def connect(name: str, address: str) -> rr.RecordingStream:
    """A recording that is sent to a running viewer. The layout has all of `scene.GROUPS`."""
    recording = new_recording(name)
    recording.connect_grpc(address, default_blueprint=blueprint(GROUPS, live=True))
    return recording


def log_static(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log what is constant: axes, airframe, names and colours of the curves."""
    recording.log("world", rr.ViewCoordinates.FRD, static=True)
    recording.log(
        "world/vehicle/body", rr.Boxes3D(half_sizes=[[0.03, 0.012, 0.008]], colors=[(220, 220, 220)]), static=True
    )
    recording.log(
        "world/vehicle/arms",
        rr.LineStrips3D([[ROTORS[0], ROTORS[1]], [ROTORS[2], ROTORS[3]]], colors=[(200, 200, 200)], radii=[0.004]),
        static=True,
    )
    recording.log("world/target", rr.Points3D.from_fields(colors=[TARGET_COLOUR], radii=[0.02]), static=True)
    recording.log("world/trail", rr.Points3D.from_fields(colors=[TRAIL_COLOUR], radii=[0.006]), static=True)
    recording.log("world/vehicle/thrust", rr.Arrows3D.from_fields(colors=[THRUST_COLOUR]), static=True)
    for name, colour in ARROW_COLOURS.items():
        recording.log(f"world/arrows/{name}", rr.Arrows3D.from_fields(colors=[colour]), static=True)
    recording.log(
        "world/vehicle/nose",
        rr.Arrows3D(vectors=[[0.08, 0.0, 0.0]], colors=[THRUST_COLOUR], radii=[0.003]),
        static=True,
    )
    counts: dict[tuple[str, bool], int] = {}
    for curve in scene.curves:
        at = counts.get((curve.group, curve.reference), 0)
        counts[curve.group, curve.reference] = at + 1
        colours = REFERENCE_COLOURS if curve.reference else CURVE_COLOURS
        style = rr.SeriesLines(
            colors=[colours[at % len(colours)]], names=[curve.name], widths=[2.5 if curve.reference else 1.2]
        )
        recording.log(curve_entity(curve), style, static=True)


def log_scene(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log everything that depends on time."""
    if scene.motion is not None:
        _log_motion(recording, scene.motion, scene.start_ns)
    if scene.target is not None:
        times, positions = scene.target
        _send(recording, "world/target", times, scene.start_ns, rr.Points3D.columns(positions=positions))
    for curve in scene.curves:
        known = np.isfinite(curve.values)
        columns = rr.Scalars.columns(scalars=curve.values[known])
        _send(recording, curve_entity(curve), curve.time_ns[known], scene.start_ns, columns)
    if scene.events:
        times = np.array([event.time_ns for event in scene.events], dtype=np.int64)
        texts = [f"{(e.time_ns - scene.start_ns) * 1e-9:7.2f} s  {e.process}: {e.text}" for e in scene.events]
        _send(recording, "events", times, scene.start_ns, rr.TextLog.columns(text=texts))


def log_paths(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log the flown path and the target path as lines."""
    paths = {"world/path/target": (scene.target[1], (110, 110, 110))} if scene.target is not None else {}
    if scene.motion is not None:
        paths["world/path/flown"] = (scene.motion.position, (0, 114, 178))
    for entity, (positions, colour) in paths.items():
        step = max(len(positions) // PATH_POINTS_MAX, 1)
        recording.log(entity, rr.LineStrips3D([positions[::step]], colors=[colour], radii=[0.004]), static=True)


def _log_motion(recording: rr.RecordingStream, motion: Motion, start_ns: int) -> None:
    n = len(motion.time_ns)
    xyzw = motion.quaternion[:, [1, 2, 3, 0]]
    pose = rr.Transform3D.columns(translation=motion.position, quaternion=xyzw)
    _send(recording, "world/vehicle", motion.time_ns, start_ns, pose)
    trail = rr.Points3D.columns(positions=motion.position)
    _send(recording, "world/trail", motion.time_ns, start_ns, trail)
    thrust = np.zeros((n, 4, 3))
    thrust[:, :, 2] = -THRUST_M_PER_N * motion.thrust
    arrows = rr.Arrows3D.columns(vectors=thrust.reshape(-1, 3), origins=np.tile(np.array(ROTORS), (n, 1))).partition(
        [4] * n
    )
    _send(recording, "world/vehicle/thrust", motion.time_ns, start_ns, arrows)
    for name, vectors in motion.arrows.items():
        columns = rr.Arrows3D.columns(vectors=ARROW_SCALE[name] * vectors, origins=motion.position)
        _send(recording, f"world/arrows/{name}", motion.time_ns, start_ns, columns)


def _send(recording: rr.RecordingStream, entity: str, times_ns: Any, start_ns: int, columns: Any) -> None:
    if len(times_ns) == 0:
        return
    seconds = (times_ns - start_ns) * 1e-9
    rr.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=seconds)], columns, recording=recording)


def curve_entity(curve: Curve) -> str:
    """Entity path of a curve. Those of references sort first, so that they are drawn below the others."""
    return f"{group_entity(curve.group)}/{'_reference_' if curve.reference else ''}{_word(curve.name)}"


def group_entity(group: str) -> str:
    """Entity path of a group of curves."""
    return f"curves/{_word(group)}"


def _word(text: str) -> str:
    return "".join(character if character.isascii() and character.isalnum() else "_" for character in text).strip("_")


def blueprint(groups: tuple[str, ...], span_s: tuple[float, float] | None = None, live: bool = False) -> rrb.Blueprint:
    """The layout: the 3-D view and the events on the left, the curves on the right.

    Parameters
    ----------
    span_s: time span that the curves show at first; None for all data.
    live: the cursor stays at the newest data.
    """
    tabs = []
    for name, wanted in TABS.items():
        views = [_curves(group, span_s) for group in wanted if group in groups]
        tabs += [rrb.Vertical(*views, name=name)] if views else []
    left = rrb.Vertical(_room(), _events(), row_shares=[4, 1])
    return rrb.Blueprint(
        rrb.Horizontal(left, rrb.Tabs(*tabs), column_shares=[3, 2]) if tabs else left,
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following" if live else None),
        auto_views=False,
    )


def _room() -> rrb.Spatial3DView:
    trail = rrb.VisibleTimeRange(
        TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-TRAIL_S),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    return rrb.Spatial3DView(
        origin="world",
        name="room (grey: target, blue: wind, red: true disturbance, green: nu_ad)",
        overrides={"world/trail": rrb.VisibleTimeRanges(trail)},
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.5),
        eye_controls=rrb.EyeControls3D(
            position=(-1.7, 0.9, -2.0), look_target=(0.0, 0.0, -0.8), eye_up=(0.0, 0.0, -1.0)
        ),
    )


def _events() -> rrb.TextLogView:
    # without a column for the time, which would be too narrow
    columns = rrb.TextLogColumns(timeline_columns=[], text_log_columns=["Body"])
    return rrb.TextLogView(origin="events", name="events", columns=columns)


def _curves(group: str, span_s: tuple[float, float] | None) -> rrb.TimeSeriesView:
    axis = None
    if span_s is not None:
        first, last = (rrb.TimeRangeBoundary.absolute(seconds=at) for at in span_s)
        axis = rrb.TimeAxis(view_range=rr.TimeRange(start=first, end=last))
    legend = rrb.PlotLegend(corner="LeftTop")
    return rrb.TimeSeriesView(origin=group_entity(group), name=group, plot_legend=legend, axis_x=axis)
