"""Starting, watching and ending the processes of a flight, with scripted stand-ins."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from configs.addresses import ADDRESSES, Addresses
from configs.flight_tree import Choices
from experiments.flights import realtime_flight
from experiments.flights.realtime_flight import (
    Child,
    FlightStartError,
    RealtimeResult,
    free_vehicle_number,
    process_command,
    run,
)
from runtime.sockets import AddressInUseError, DatagramSocket

ROOT = Path(__file__).resolve().parents[3]
NETWORK = Addresses()
LATER = {name: f"127.0.0.1:{15460 + index}" for index, name in enumerate(ADDRESSES)}
NETWORK = NETWORK.model_copy(update=LATER)

STAND_IN = """
import json, signal, sys, time
from pathlib import Path

out = Path(sys.argv[sys.argv.index("--out") + 1])
asked = []
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, lambda number, frame: asked.append(number))

def say(**entry):
    print(json.dumps({"process": NAME, **entry}), flush=True)

def serve(seconds, ends_on=1):
    start = time.monotonic()
    while len(asked) < ends_on and time.monotonic() - start < seconds:
        say(kind="status", time_s=time.monotonic() - start)
        time.sleep(0.02)

def finish(status=0, **summary):
    (out / f"{NAME}_summary.json").write_text(json.dumps({"asked": len(asked), **summary}))
    sys.exit(status)
"""
BODIES = {
    "sim": "say(kind='event', text='ready'); serve(0.6); finish(survived=True)",
    "offboard": "say(kind='event', text='ready'); serve(30); finish()",
    "onboard": "say(kind='event', text='ready'); serve(30); finish(ticks=1)",
}


@pytest.fixture
def stand_ins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Replaces the three processes by modules of the test."""
    folder = tmp_path / "modules"
    folder.mkdir()
    monkeypatch.setenv("PYTHONPATH", str(folder))

    def put(**bodies: str) -> None:
        modules = {}
        for name, body in {**BODIES, **bodies}.items():
            (folder / f"stand_in_{name}.py").write_text(f"NAME = {name!r}\n{STAND_IN}\n{body}\n", encoding="utf-8")
            modules[name] = f"stand_in_{name}"
        monkeypatch.setattr(realtime_flight, "MODULES", modules)

    put()
    return put


def fly(tmp_path: Path, entries: list[dict] | None = None) -> RealtimeResult:
    return run(NETWORK, tmp_path / "config.yaml", 5.0, tmp_path, (entries if entries is not None else []).append)


def test_ends_when_the_vehicles_time_is_over(stand_ins, tmp_path: Path) -> None:
    entries: list[dict] = []
    result = fly(tmp_path, entries)
    assert result.sim == {"asked": 0, "survived": True}
    assert result.onboard == {"asked": 1, "ticks": 1}
    assert result.offboard == {"asked": 1}
    assert result.exit_status == {"sim": 0, "offboard": 0, "onboard": 0}
    assert not result.interrupted
    assert not result.notes
    assert {entry["process"] for entry in entries} == {"sim", "offboard", "onboard"}
    assert not list(tmp_path.glob("*_errors.txt"))


def test_continues_when_offboard_is_killed(stand_ins, tmp_path: Path) -> None:
    stand_ins(offboard="say(kind='event', text='ready'); serve(0.3); import os; os.kill(os.getpid(), 9)")
    result = fly(tmp_path)
    assert result.sim == {"asked": 0, "survived": True}
    assert result.offboard is None
    assert result.exit_status["offboard"] == -signal.SIGKILL
    assert "goes on without it; start another with:" in result.notes[1]


@pytest.mark.parametrize("end", ["import os; os.kill(os.getpid(), 9)", "raise MemoryError('none left')"])
def test_flies_without_an_offboard_that_dies_before_it_is_ready(stand_ins, tmp_path: Path, end: str) -> None:
    long_enough = BODIES["sim"].replace("serve(0.6)", "serve(4.0)")  # for onboard to start on a busy machine
    stand_ins(offboard=end, sim=long_enough)
    result = fly(tmp_path)
    assert result.sim == {"asked": 0, "survived": True}
    assert result.onboard == {"asked": 1, "ticks": 1}
    assert result.notes[0] in (
        "offboard ended (killed by SIGKILL)",
        "offboard ended (status 1): MemoryError: none left",
    )
    assert "goes on without it; start another with:" in result.notes[1]


def test_flies_without_an_offboard_that_is_never_ready(
    stand_ins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(realtime_flight, "READY_LIMIT_S", 3.0)
    stand_ins(offboard="serve(30); finish()")
    result = fly(tmp_path)
    assert result.sim == {"asked": 0, "survived": True}
    assert result.notes == ["offboard is not ready after 3 s; the flight starts without it"]


def test_a_needed_process_that_is_never_ready_ends_the_flight(
    stand_ins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(realtime_flight, "READY_LIMIT_S", 1.0)
    stand_ins(sim="serve(30); finish()")
    with pytest.raises(FlightStartError, match=r"sim .*not ready within 1 s"):
        fly(tmp_path)


def test_a_process_that_cannot_start_ends_the_others_and_its_error_is_quoted(stand_ins, tmp_path: Path) -> None:
    stand_ins(offboard="print('offboard.labels: unknown key', file=sys.stderr); sys.exit(2)")
    with pytest.raises(
        FlightStartError, match=r"offboard ended at its start \(status 2\): offboard.labels: unknown key"
    ):
        fly(tmp_path)


def test_the_death_of_onboard_in_flight_is_reported(stand_ins, tmp_path: Path) -> None:
    stand_ins(onboard="say(kind='event', text='ready'); raise RuntimeError('broken')", sim=BODIES["offboard"])
    result = fly(tmp_path)
    assert result.exit_status["onboard"] == 1
    assert any("onboard ended in flight (status 1): RuntimeError: broken" in note for note in result.notes)


def test_a_process_that_does_not_end_is_killed(stand_ins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(realtime_flight, "END_LIMIT_S", 0.3)
    stand_ins(onboard="say(kind='event', text='ready'); serve(30, ends_on=99)")
    assert fly(tmp_path).exit_status["onboard"] == -signal.SIGKILL


@pytest.mark.parametrize(("presses", "expected"), [(1, "landing"), (2, "ended at once")])
def test_ctrl_c_lands_and_a_second_one_ends_at_once(stand_ins, tmp_path: Path, presses: int, expected: str) -> None:
    onboard = f"say(kind='event', text='ready'); serve(30, {presses}); time.sleep(0.5); finish(landed=True)"
    stand_ins(sim=BODIES["offboard"], onboard=onboard)
    seen: list[float] = []

    def press(entry: dict) -> None:
        if entry["process"] != "onboard" or len(seen) >= presses or entry.get("kind") == "event":
            return
        seen.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    start = time.monotonic()
    before = signal.getsignal(signal.SIGINT)
    result = run(NETWORK, tmp_path / "config.yaml", 5.0, tmp_path, press)
    assert signal.getsignal(signal.SIGINT) is before
    assert time.monotonic() - start < 12.0
    assert any(expected in note for note in result.notes)
    assert result.interrupted
    assert result.onboard is not None
    assert result.onboard["landed"]
    assert result.onboard["asked"] >= presses
    assert None not in result.exit_status.values()


def test_a_taken_port_is_named_and_nothing_is_started(stand_ins, tmp_path: Path) -> None:
    network = NETWORK.model_copy(update={"offboard_link": "127.0.0.5:15999"})  # not used by other tests
    taken = DatagramSocket("other", network.offboard_link, None)
    with pytest.raises(AddressInUseError, match=r"network\.offboard_link: 127\.0\.0\.5:15999 is in use"):
        run(network, tmp_path / "config.yaml", 5.0, tmp_path)
    taken.close()
    assert not list(tmp_path.glob("*_summary.json"))


def test_no_process_outlives_a_killed_parent(stand_ins, tmp_path: Path) -> None:
    script = (
        "import sys, time; from pathlib import Path; from experiments.flights import realtime_flight as r\n"
        "r.MODULES = {'onboard': 'stand_in_onboard'}; out = Path(sys.argv[1])\n"
        "child = r.Child('onboard', r.process_command('onboard', Path('x'), out), out)\n"
        "print(child.process.pid, flush=True); time.sleep(60)"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path)],
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": f"{os.environ['PYTHONPATH']}:{ROOT}"},
    )
    with parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        parent.kill()
    limit = time.monotonic() + 5.0
    while Path(f"/proc/{child}").exists() and _state(child) != "Z":
        assert time.monotonic() < limit, "the child lives on"
        time.sleep(0.02)


def test_other_output_between_the_lines_is_ignored(stand_ins, tmp_path: Path) -> None:
    stand_ins(sim="print('warning: something'); print('[1]'); say(kind='event', text='ready'); finish()")
    child = Child("sim", process_command("sim", tmp_path / "config.yaml", tmp_path), tmp_path)
    child.process.wait()
    assert child.lines() == [{"process": "sim", "kind": "event", "text": "ready"}]
    assert child.ready
    child.tidy()


def _state(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0]
    except OSError:
        return "Z"


def test_the_lowest_number_of_a_vehicle_with_free_ports_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def two_fly(network: Addresses) -> None:
        if network.vehicle in ("127.0.0.1:14560", "127.0.0.1:14660"):
            raise AddressInUseError(network.vehicle)

    monkeypatch.setattr(realtime_flight, "require_free_ports", two_fly)
    assert free_vehicle_number("hover", Choices()) == 3
    given = Choices(assignments=("network.vehicle=127.0.0.1:14560",))
    assert free_vehicle_number("hover", given) is None
