"""Exports for other tools, read back with the libraries that those tools use."""

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from async_dmrac.command_line import main
from flight_log.reader import Flight, FlightError, open_flight
from tests.flight_log.conftest import write_full_flight

pytest.importorskip("foxglove")
pytest.importorskip("rosbags")
pytest.importorskip("mcap_ros2")
pytest.importorskip("tensorboard")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_full_flight(tmp_path_factory.mktemp("full") / "flight")


@pytest.fixture(scope="module")
def flight(folder: Path) -> Flight:
    return open_flight(folder)


@pytest.fixture(scope="module")
def exported(folder: Path) -> Path:
    words = ["--parquet", "--foxglove", "--rosbag", "--tensorboard"]
    assert main(["log", "export", str(folder), *words]) == 0
    return folder / "export"


def read_ros(path: Path) -> dict[str, list[Any]]:
    """The CDR messages of an MCAP file, decoded by mcap-ros2-support, by topic."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    decoder, found = DecoderFactory(), dict[str, list[Any]]()
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.message_encoding == "cdr":
                decode = decoder.decoder_for("cdr", schema)
                assert decode is not None
                found.setdefault(channel.topic, []).append((message.log_time, decode(message.data)))
    return found


def test_ros_tools_read_the_bag(exported: Path, flight: Flight) -> None:
    from rosbags.rosbag2 import Reader

    with Reader(exported / "rosbag") as bag:
        types = {connection.topic: connection.msgtype for connection in bag.connections}
    assert types["/tf"] == "tf2_msgs/msg/TFMessage"
    assert types["/odometry"] == types["/truth/odometry"] == "nav_msgs/msg/Odometry"
    assert types["/imu"] == "sensor_msgs/msg/Imu"
    assert types["/actuators"] == "actuator_msgs/msg/Actuators"
    [path] = (exported / "rosbag").glob("*.mcap")
    messages = read_ros(path)
    tick, truth = flight["onboard/tick"], flight["sim_vehicle/truth"]
    row = len(truth) // 2
    time_ns, odometry = messages["/truth/odometry"][row]
    assert time_ns == truth.time_ns[row]
    assert odometry.header.stamp.sec * 10**9 + odometry.header.stamp.nanosec == time_ns
    assert odometry.pose.pose.position.x == truth["position_e"][row]
    assert odometry.pose.pose.position.y == truth["position_n"][row]
    assert odometry.pose.pose.position.z == -truth["position_d"][row]
    assert len(messages["/odometry"]) == len(messages["/imu"]) == len(tick)
    _, actuators = messages["/actuators"][row]
    np.testing.assert_array_equal(actuators.normalized, [tick[f"motor_{number}"][row] for number in "1234"])
    children = {message.transforms[0].child_frame_id for _, message in messages["/tf"]}
    assert children == {"base_link", "estimate"}


def test_an_imu_at_rest_measures_gravity_upwards(exported: Path) -> None:
    [path] = (exported / "rosbag").glob("*.mcap")
    _, imu = read_ros(path)["/imu"][0]
    force = imu.linear_acceleration
    np.testing.assert_allclose([force.x, force.y, force.z], [0.0, 0.0, 9.80665], atol=1e-9)


def test_without_the_truth_the_acceleration_is_unknown(folder: Path, tmp_path: Path) -> None:
    alone = tmp_path / "onboard.mcap"
    alone.write_bytes((folder / "onboard.mcap").read_bytes())
    assert main(["log", "export", str(alone), "--rosbag"]) == 0
    [path] = (tmp_path / "export" / "rosbag").glob("*.mcap")
    messages = read_ros(path)
    assert messages["/imu"][0][1].linear_acceleration_covariance[0] == -1.0
    assert "/truth/odometry" not in messages


def test_foxglove_finds_its_schemas_and_every_number_by_name(exported: Path, flight: Flight) -> None:
    from mcap.reader import make_reader

    path = exported / "flight.mcap"
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    kinds = {one.topic: summary.schemas[one.schema_id].name for one in summary.channels.values()}
    assert kinds["/transforms"] == "foxglove.FrameTransform"
    assert kinds["/vehicle/pose"] == kinds["/target/pose"] == "foxglove.PoseInFrame"
    assert kinds["/vehicle/scene"] == kinds["/paths"] == "foxglove.SceneUpdate"
    messages = read_ros(path)
    tick = flight["onboard/tick"]
    shown = [message.position_n for _, message in messages["/onboard/tick"]]
    np.testing.assert_array_equal(shown, tick["position_n"])
    assert [time_ns for time_ns, _ in messages["/onboard/tick"]] == tick.time_ns.tolist()


def paths_of(node: Any) -> list[str]:
    """Every message path in a layout."""
    if isinstance(node, dict):
        own = [node["value"]] if isinstance(node.get("value"), str) else []
        return own + [path for one in node.values() for path in paths_of(one)]
    return [path for one in node for path in paths_of(one)] if isinstance(node, list) else []


def test_the_layout_shows_what_is_in_the_file(exported: Path) -> None:
    layout = json.loads((exported / "layout.json").read_text(encoding="utf-8"))
    messages = read_ros(exported / "flight.mcap")
    paths = paths_of(layout)
    assert len(paths) > 8
    for path in paths:
        topic, _, name = path.partition(".")
        name, _, index = name.partition("[")
        value = getattr(messages[topic][0][1], name)
        assert not index or len(value) > int(index.rstrip("]")), path
    assert "/vehicle/scene" in json.dumps(layout)


def test_pandas_and_others_read_parquet_with_units(exported: Path, flight: Flight) -> None:
    import pyarrow.parquet as pq

    found, tick = pq.read_table(exported / "onboard_tick.parquet"), flight["onboard/tick"]
    assert found.column_names == ["time_s", "time_ns", *tick.names]
    assert found.schema.field("position_n").metadata == {b"unit": b"m"}
    np.testing.assert_array_equal(found["position_n"].to_numpy(), tick["position_n"])
    events = pq.read_table(exported / "events.parquet").to_pylist()
    assert [one["event"] for one in events] == [event.text for event in flight.events]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_tensorboard_shows_the_losses(exported: Path, flight: Flight) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    run = EventAccumulator(str(exported / "tensorboard"))
    run.Reload()
    training = flight["offboard/training"]
    points = run.Scalars("validation_loss/position")
    assert [point.step for point in points] == training["round"].astype(int).tolist()
    np.testing.assert_allclose([point.value for point in points], training["validation_loss_position"], rtol=1e-6)
    assert "gate/verdict" in run.Tags()["scalars"]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_tensorboard_follows_a_flight_while_it_is_logged(
    exported: Path, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    import flight_log.tensorboard as board

    def scalars(run: Path) -> list[tuple[float, int, float]]:
        accumulator = EventAccumulator(str(run))
        accumulator.Reload()
        points = accumulator.Scalars("validation_loss/position")
        return [(point.wall_time, point.step, point.value) for point in points]

    monkeypatch.setattr(board, "POLL_PERIOD_S", 0.01)
    flight, growing, run = open_flight(folder), tmp_path / "growing", tmp_path / "run"
    expected = sum(len(flight[topic]) for topic in (board.TRAINING_TOPIC, board.EPOCH_TOPIC) if topic in flight)
    growing.mkdir()
    with board.live_tensorboard(growing, run) as follower:
        for name in ("onboard.mcap", "offboard.mcap"):
            data = (folder / name).read_bytes()
            with (growing / name).open("wb") as file:
                for part in (data[: len(data) // 2], data[len(data) // 2 :]):
                    file.write(part)
                    file.flush()
                    time.sleep(0.1)
        deadline = time.monotonic() + 60.0
        while (follower.run is None or follower.run.entries < expected) and time.monotonic() < deadline:
            time.sleep(0.01)
        assert scalars(run) == scalars(exported / "tensorboard")  # before the flight has ended


def test_a_flight_that_trains_nothing_leaves_no_run(flight_folder: Path, tmp_path: Path) -> None:
    from flight_log.tensorboard import live_tensorboard

    with live_tensorboard(flight_folder, tmp_path / "run") as follower:
        pass
    assert follower.run is None
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(("word", "message"), [("--foxglove", "exists already"), ("--rosbag", "exists already")])
def test_nothing_is_overwritten(
    word: str, message: str, exported: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["log", "export", str(folder), word]) == 2
    assert message in capsys.readouterr().err


def test_a_flight_without_training_has_no_run(flight_folder: Path, tmp_path: Path) -> None:
    from flight_log.tensorboard import write_tensorboard

    with pytest.raises(FlightError, match="nothing was trained"):
        write_tensorboard(open_flight(flight_folder), tmp_path / "run")
