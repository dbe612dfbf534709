from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from flight_log.live import END_FILE, FlightTail, follow
from flight_log.log_file import LogTail
from flight_log.reader import FlightError, open_flight
from flight_log.scene import GROUPS, PLAIN_CURVES, Curve, Scene, build_scene
from flight_log.schema import RecordType
from flight_log.writer import FlightLogWriter
from offboard import records as offboard_records
from onboard.record import tick as tick_record
from sim_vehicle import records as sim_records
from sim_vehicle.link import radio


def curve(scene: Scene, group: str, name: str) -> Curve:
    return next(found for found in scene.curves if (found.group, found.name) == (group, name))


def test_the_curves_name_columns_that_the_processes_log() -> None:
    logged = {kind.topic: kind.names for kind in (tick_record.TICK, *offboard_records.RECORDS)}
    for group, _, topic, column, _, _ in PLAIN_CURVES:
        assert group in GROUPS
        if topic != "onboard/loop":
            assert column in logged[topic]


def test_a_flight_becomes_motion_target_curves_and_events(full_flight: Path) -> None:
    flight = open_flight(full_flight)
    scene = build_scene(flight)
    assert scene.motion is not None
    assert scene.target is not None
    np.testing.assert_array_equal(scene.motion.position[:, 0], flight["sim_vehicle/truth"]["position_n"])
    np.testing.assert_array_equal(scene.motion.arrows["wind"][:, 0], 4.0)
    np.testing.assert_allclose(scene.motion.arrows["nu_ad"][:, 0], 0.3, atol=1e-6)
    assert scene.motion.thrust[0].tolist() == pytest.approx([0.17, 0.0, 0.0, 0.0])
    assert [event.text for event in scene.events] == ["mode FLYING <fast>"]
    assert scene.groups[:2] == ("position [m]", "attitude [deg]")
    assert "training loss, position [(m/s²)²]" in scene.groups
    north = curve(scene, "position [m]", "north").values - curve(scene, "position [m]", "target north").values
    np.testing.assert_allclose(north, 0.1, atol=1e-6)
    np.testing.assert_allclose(curve(scene, "adaptive, position [m/s²]", "true north").values, 0.0, atol=1e-6)
    age = curve(scene, "features", "age [s]")
    assert np.isnan(age.values[:200]).all()


def test_w_max_is_drawn_where_the_configuration_has_one(tmp_path: Path) -> None:
    law = "{augmentation: {law: {weight_norm_max: 40.0}}}"
    config = f"onboard: {{controller: {{settings: {{position: {law}, attitude: {{augmentation: {{kind: none}}}}}}}}}}"
    attachments = {"config.yaml": config.encode()}
    with FlightLogWriter(tmp_path / "onboard.mcap", "onboard", attachments=attachments, threaded=False) as log:
        for i in range(3):
            log.write(tick_record.TICK, i * 5_000_000, np.zeros(len(tick_record.TICK.names)))
    curves = [one for one in build_scene(open_flight(tmp_path)).curves if one.name.startswith("W_max")]
    assert [(one.name, one.values.tolist()) for one in curves] == [("W_max, position", [40.0, 40.0])]


def test_a_flight_without_truth_shows_the_estimate(full_flight: Path) -> None:
    (full_flight / "sim_vehicle.mcap").unlink()
    scene = build_scene(open_flight(full_flight))
    assert scene.motion is not None
    assert scene.motion.thrust[0].tolist() == pytest.approx([0.16, 0.0, 0.0, 0.0])
    assert set(scene.motion.arrows) == {"nu_ad"}


def test_the_force_of_the_floor_is_not_drawn(tmp_path: Path) -> None:
    names = sim_records.TRUTH.names
    with FlightLogWriter(tmp_path / "sim_vehicle.mcap", "sim_vehicle", threaded=False) as log:
        for i in range(10):
            values = dict.fromkeys(names, 0.0) | {"position_d": -0.1 * i, "disturbance_force_d": -0.6}
            log.write(sim_records.TRUTH, i * 20_000_000, np.array(list(values.values())))
    motion = build_scene(open_flight(tmp_path)).motion
    assert motion is not None
    assert motion.arrows["disturbance"][:, 2].tolist() == pytest.approx([0.0, 0.0, *[-0.6] * 8])


def test_fast_topics_are_thinned(tmp_path: Path) -> None:
    kind = RecordType("onboard/loop", (("tick", "us"),))
    with FlightLogWriter(tmp_path / "onboard.mcap", "onboard", threaded=False) as log:
        for i in range(1000):
            log.write(kind, i * 1_000_000, np.array([float(i)]))
    loop = curve(build_scene(open_flight(tmp_path)), "loop [us]", "tick")
    assert len(loop.values) == 50


def test_losses_are_counted_over_a_second(tmp_path: Path) -> None:
    with FlightLogWriter(tmp_path / "sim_vehicle.mcap", "sim_vehicle", threaded=False) as log:
        for i in range(400):
            lost = 100 <= i < 200 or i % 10 == 0
            outcome, delay = ("burst", -1) if lost else ("delivered", 10**7)
            delivery = radio.Delivery(i * 10_000_000, 100, outcome, delay, -1, -1)
            log.write(radio.DELIVERY, i * 10_000_000, radio.delivery_vector("down", delivery))
    scene = build_scene(open_flight(tmp_path))
    down = curve(scene, "datagrams lost in 1 s [%]", "down")
    assert down.values[[99, 199, 399]] == pytest.approx([10.0, 100.0, 10.0], abs=1.0)
    assert len(curve(scene, "datagrams lost in 1 s [%]", "up").values) == 0
    delay = curve(scene, "delay of datagrams [ms]", "down").values
    assert delay[[99, 201]] == pytest.approx([10.0, 10.0])
    assert np.isnan(delay[100:200]).all()


def test_a_growing_log_is_read_in_parts(tmp_path: Path) -> None:
    kind = RecordType("onboard/loop", (("tick", "us"),))
    path = tmp_path / "onboard.mcap"
    log = FlightLogWriter(path, "onboard", threaded=False)
    tail, seen = LogTail(path), []
    for i in range(1000):
        log.write(kind, i * 5_000_000, np.array([float(i)]))
        if i % 150 == 0:
            new = tail.read().vectors
            seen += new["onboard/loop"].values[:, 0].tolist() if new else []
    log.close()
    seen += tail.read().vectors["onboard/loop"].values[:, 0].tolist()
    assert seen == list(range(1000))
    assert tail.read().record_count == 0


def test_a_flight_is_followed_until_its_summary_is_written(full_flight: Path, tmp_path: Path) -> None:
    whole = build_scene(open_flight(full_flight))
    growing = tmp_path / "growing"
    growing.mkdir()
    tail = FlightTail(growing)
    assert tail.read() is None
    scenes: list[Scene] = []
    data = {path.name: path.read_bytes() for path in full_flight.glob("*.mcap")}
    for share in (0.3, 0.7, 1.0):
        for name, content in data.items():
            (growing / name).write_bytes(content[: int(share * len(content))])
        scene = tail.read()
        scenes += [scene] if scene is not None else []
    assert len(scenes) == 3
    assert {scene.start_ns for scene in scenes} == {whole.start_ns}
    parts = [scene.motion.position for scene in scenes if scene.motion is not None]
    assert whole.motion is not None
    np.testing.assert_array_equal(np.concatenate(parts), whole.motion.position)
    (growing / END_FILE).write_text("{}", encoding="utf-8")
    assert len(list(follow(growing, lambda: True))) == 1


def test_the_live_time_line_starts_at_onboards_first_tick(full_flight: Path, tmp_path: Path) -> None:
    growing, now_s = tmp_path / "growing", [0.0]
    growing.mkdir()
    (growing / "offboard.mcap").write_bytes((full_flight / "offboard.mcap").read_bytes())
    waiting, alone = (FlightTail(growing, 10.0, lambda: now_s[0]) for _ in range(2))
    assert waiting.read() is None
    assert alone.read() is None
    (growing / "onboard.mcap").write_bytes((full_flight / "onboard.mcap").read_bytes())
    scene = waiting.read()
    assert scene is not None
    assert scene.start_ns == open_flight(full_flight).start_ns
    assert "training loss, position [(m/s²)²]" in scene.groups  # records that arrived in between are not lost
    (growing / "onboard.mcap").unlink()
    now_s[0] = 11.0
    alone_scene = FlightTail(growing, 0.0).read()
    assert alone_scene is not None
    assert alone_scene.groups == ("training loss, position [(m/s²)²]", "training loss, attitude [(rad/s²)²]")


def test_following_a_folder_without_logs_raises_with_one_line(tmp_path: Path, make_flight: Callable[..., Path]) -> None:
    with pytest.raises(FlightError, match="no flight log appeared within 0 s"):
        list(follow(tmp_path, lambda: True, start_limit_s=0.0))
    assert list(follow(make_flight("unwanted"), lambda: False)) == []


def test_the_tracking_error_is_drawn_with_its_live_bound_where_the_log_has_one(full_flight: Path) -> None:
    scene = build_scene(open_flight(full_flight))
    np.testing.assert_allclose(curve(scene, "tracking error, position [m]", "error").values, 0.1, atol=1e-6)
    np.testing.assert_allclose(curve(scene, "tracking error, position [m]", "live bound").values, 0.2, atol=1e-6)
    assert np.isnan(curve(scene, "tracking error, attitude [deg]", "live bound").values).all(), "0: none"


def test_an_older_log_has_no_live_bound(tmp_path: Path) -> None:
    older = RecordType("onboard/tick", tuple(one for one in tick_record.TICK.fields if "tracking_bound" not in one[0]))
    with FlightLogWriter(tmp_path / "onboard.mcap", "onboard", threaded=False) as log:
        for i in range(3):
            log.write(older, i * 5_000_000, np.zeros(len(older.names)))
    names = {one.name for one in build_scene(open_flight(tmp_path)).curves if one.group.startswith("tracking error")}
    assert names == {"error"}
