"""The public functions: fly a scenario, read a record, and the errors that a user sees."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import async_dmrac
from configs.loader import ConfigError
from flight_log.reader import FlightError
from sim_vehicle.physics.layout import FORCE
from sim_vehicle.records import TRUTH

ROOT = Path(__file__).resolve().parents[2]


def test_a_flight_returns_its_record_and_can_be_loaded_again(tmp_path: Path) -> None:
    out = tmp_path / "flown"
    settings = {"vehicle.body.mass_kg": 0.065, "vehicle.initial.position_ned_m": [0.1, 0.0, 0.0]}
    flight = async_dmrac.fly("hover", controller="pid", seed=3, duration_s=5.0, set=settings, out=out)
    tick = flight["onboard/tick"]
    assert len(tick) == 1000
    assert flight[TRUTH.topic]["position_n"][0] == pytest.approx(0.1, abs=1e-3)
    assert (flight.summary["controller"], flight.summary["seed"], flight.summary["mode"]) == ("pid", 3, "lockstep")
    assert flight.summary["survived"]
    assert flight.summary["onboard"]["calibration"]["accepted"] == 1
    assert {"config.yaml", "onboard.mcap", "summary.json", "flight.png", "report.html"} <= {
        path.name for path in out.iterdir()
    }
    again = async_dmrac.load_flight(out)
    assert again.summary == flight.summary
    assert (again["onboard/tick"].values == tick.values).all()
    assert (async_dmrac.load_flight(out / "onboard.mcap")["onboard/tick"].values == tick.values).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenario": "nowhere"}, "unknown scenario 'nowhere': allowed are blackout, "),
        ({"controller": "magic"}, "unknown controller 'magic': allowed are bias, "),
        ({"seed": -1}, "greater than or equal to 0"),
        ({"duration_s": 1.0}, "greater than or equal to 5"),
        ({"set": {"vehicle.body.weight": 1.0}}, r"vehicle\.body\.weight: unknown key; allowed are "),
        ({"set": {"vehicle.body.mass_kg": "heavy"}}, r"vehicle\.body\.mass_kg: 'heavy'"),
    ],
)
def test_a_wrong_argument_is_named_and_leaves_no_folder(
    arguments: dict[str, object], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=message):
        async_dmrac.fly(**{"scenario": "hover"} | arguments)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_a_flight_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("{}")
    with pytest.raises(ConfigError, match="already"):
        async_dmrac.fly("hover", duration_s=5.0, out=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["summary.json"]


def test_a_folder_without_a_log_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FlightError, match=str(tmp_path)):
        async_dmrac.load_flight(tmp_path)


def test_there_is_nothing_else() -> None:
    for name in async_dmrac.__all__:
        assert getattr(async_dmrac, name) is not None
    assert dir(async_dmrac) == sorted(async_dmrac.__all__)
    with pytest.raises(AttributeError, match="no attribute 'land'"):
        async_dmrac.land  # noqa: B018


def test_importing_it_stays_light() -> None:
    heavy = ("torch", "numba", "matplotlib", "pyarrow", "pandas", "gymnasium", "scipy", "pydantic", "numpy")
    code = f"import sys, async_dmrac; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT, timeout=60
    )
    assert done.stdout == "[]\n"


class Push(async_dmrac.Disturbance):
    """A constant force to the north."""

    force_n: float

    def values(self) -> tuple[float, ...]:
        return (self.force_n,)

    @staticmethod
    def act(v, memory, time_s, state, P, noise, effect):  # type: ignore[no-untyped-def]
        effect[FORCE] += v[0]


def push_of_a_notebook() -> async_dmrac.Disturbance:
    here = type("Push", (Push,), {"__qualname__": "push_of_a_notebook.<locals>.Push", "__module__": __name__})
    return here(force_n=0.1)


def test_a_class_of_a_notebook_flies_and_its_record_has_tables_metrics_and_figures(tmp_path: Path) -> None:
    class Steady:
        class Settings(async_dmrac.ConfigRecord):
            thrust_n: float = async_dmrac.Field(gt=0)

        def __init__(self, settings: Settings, airframe: object, seed: int) -> None:
            self.thrust_n = settings.thrust_n

        def reset(self, inputs: async_dmrac.ControlInputs) -> None:
            pass

        def step(self, inputs: async_dmrac.ControlInputs) -> async_dmrac.ControlOutput:
            return async_dmrac.ControlOutput(thrust_n=self.thrust_n)

    settings = {"thrust_n": 0.3}  # less than the weight
    flight = async_dmrac.fly(
        "hover", Steady, 3, settings=settings, disturbances=[Push(force_n=0.02)], duration_s=5.0, out=tmp_path / "one"
    )
    truth = flight["sim_vehicle/truth"]
    assert flight.summary["controller"] == "Steady"
    assert np.abs(truth["disturbance_force_n"]).max() > 0.01
    assert truth.time_s[-1] == pytest.approx(5.0, abs=0.1)
    table = flight["onboard/tick"].to_arrow()
    assert table.column_names[:2] == ["time_s", "mode"]
    assert table.schema.field("position_n").metadata == {b"unit": b"m"}
    assert table.column("position_n").to_numpy() == pytest.approx(flight["onboard/tick"]["position_n"])
    assert flight.metrics.lap_rmse_m == ()
    assert len(flight.figure().axes) > 5
    assert flight.config["onboard"]["controller"]["settings"] == {"thrust_n": 0.3}
    assert "onboard/tick" in repr(flight)


def test_pandas_or_a_message_that_names_it(tmp_path: Path) -> None:
    table = async_dmrac.Table("t", ("x",), {"x": "m"}, np.array([5, 10]), np.array([[1.0], [2.0]]), start_ns=5)
    if find_spec("pandas") is None:
        with pytest.raises(ImportError, match="to_pandas: not installed: pandas"):
            table.to_pandas()
        return
    frame = table.to_pandas()
    assert frame["x"].tolist() == [1.0, 2.0]
    assert frame.attrs["units"] == {"x": "m"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"core": "rust"}, "core: 'rust': allowed are numpy, c"),
        ({"settings": {"a": 1}}, "settings: only with a class as controller"),
        ({"disturbances": [3]}, "disturbances: 3: expected instances of async_dmrac.Disturbance"),
        ({"disturbances": [push_of_a_notebook()], "realtime": True}, "Push is defined in this Python session"),
        ({"realtime": True, "core": "c"}, "realtime=True: allowed with core='numpy'"),
        ({"controller": Push, "settings": {}}, "Push: controller.class: .* has no Settings"),
    ],
)
def test_a_wrong_argument_of_a_program_is_named(
    arguments: dict[str, object], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=message):
        async_dmrac.fly(**{"scenario": "hover"} | arguments)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def test_a_class_in_a_file_beside_its_yaml_file_is_configured_from_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.py").write_text(
        "from async_dmrac import ConfigRecord, Disturbance\n"
        "class Own:\n"
        "    class Settings(ConfigRecord):\n        size: float\n"
        "    def __init__(self, settings, airframe, seed): pass\n"
        "    def step(self, inputs): pass\n"
        "    def reset(self, inputs): pass\n"
        "class Pull(Disturbance):\n    def change(self, condition, drawn): pass\n"
    )
    (tmp_path / "own.yaml").write_text("class: mine.py:Own\nsettings: {size: 1.0}\n")
    (tmp_path / "flight.yaml").write_text('extends: hover\ndisturbances: [{kind: "mine.py:Pull", onset_s: 2.0}]\n')
    monkeypatch.chdir("/")
    config = async_dmrac.configure(str(tmp_path / "flight.yaml"), str(tmp_path / "own.yaml"))
    assert config.onboard.controller.class_path == f"{tmp_path}/mine.py:Own"
    assert config.vehicle.disturbances[0].kind == f"{tmp_path}/mine.py:Pull"
    (tmp_path / "own.yaml").write_text("class: other.py:Own\nsettings: {size: 1.0}\n")
    with pytest.raises(ConfigError, match=f"cannot be loaded: there is no file {tmp_path}/other.py"):
        async_dmrac.configure("hover", str(tmp_path / "own.yaml"))


def test_a_campaign_returns_its_rows(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    plan = {
        "description": "two flights",
        "controllers": ["pid", "none"],
        "cases": [{"name": "calm", "scenario": "hover", "duration_s": 6}],
        "seeds": {"first": 1000, "count": 1},
    }
    result = async_dmrac.campaign(
        plan, out=tmp_path / "flown", jobs=1, progress=lambda done, total: seen.append((done, total))
    )
    assert (result.total, result.flown, result.errors) == (2, 2, 0)
    assert seen[-1] == (2, 2)
    assert set(result["controller"]) == {"pid", "none"}
    assert all(values[0] < 0.1 for values in result.groups("position_rmse_m").values())
    with pytest.raises(KeyError, match="no column 'mood'; there are key, "):
        result["mood"]
    with pytest.raises(ConfigError, match="holds a campaign already"):
        async_dmrac.campaign(plan, out=tmp_path / "flown")
    with pytest.raises(ConfigError, match="campaign: cases"):
        async_dmrac.campaign({**plan, "cases": []})
