"""Every command that the documentation shows runs: the cheap ones always, all of them with `full`.

They run on short flights and small campaigns: `SHORTER` is appended to a command, `PLACES` replaces names that the page
leaves to its reader, `small` reduces a campaign. The rest of a command runs as it is shown.
"""

import contextlib
import io
import os
import re
import shutil
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path
from typing import Any

import pytest
import yaml

from async_dmrac.command_line import build_parser, main
from configs.addresses import ADDRESSES as NETWORK
from configs.loader import CONFIG_DIRECTORY
from experiments.campaigns import campaign as campaign_module
from experiments.results import campaign_data
from tests.dask_cluster import running_cluster
from tests.docs_commands import BLOCKS, INLINE, NO_ARGUMENTS, PAGES, ROOT, block_commands, words_of
from tests.experiments.processes import Processes

ADDRESSES = {name: f"127.0.0.1:{16660 + index}" for index, name in enumerate(NETWORK)}
"""Other addresses than those of a user's flights."""
SHORT_FLIGHT = ["--duration", "6", *(f"--set=network.{name}={address}" for name, address in ADDRESSES.items())]
SHORTER: dict[str, list[str]] = {
    "fly": SHORT_FLIGHT,
    "config": SHORT_FLIGHT,
    "attack": ["--case", "steep", "--seeds", "1"],
    "bench": ["--seconds", "2"],
    "campaign": ["--seeds", "1"],
    "demo": ["--duration", "6"],
    "dropouts": ["--duration", "6"],
    "preflight": ["--listen-only", "--bind", ADDRESSES["onboard_vehicle"]],
    "reproduce": ["--seeds", "1"],
    "tune": ["--trials", "2", "--dry-run"],
}
"""Appended to a subcommand's words; of two values of an option the last one counts."""
PLACES = {
    "udp://192.168.3.1:14560": f"udp://{ADDRESSES['vehicle']}",
    "10.0.0.7:14573": ADDRESSES["offboard_link"],
    "0.0.0.0:14574": ADDRESSES["motion_capture"],
    "SCENARIO": "hover",
    "FLIGHT": "flight",
    "NAME": "pid",
    "FILE": "rotor_chip",
    "ROWS": "campaigns/rotor_chip",
    "run/vehicle_2": "flight",
    "$1": "rotor_chip",
    "campaigns/$(basename $1 .yaml)": "campaigns/rotor_chip",
}
TOGETHER = ("sim", "offboard", "onboard")
"""Processes that need each other: those of a page run at the same time."""
BARE = ("fly", "bench", "reproduce")
"""Complete without another word; `dmrac tune` and the like only name a subcommand."""
BINDS = ["--bind-vehicle", ADDRESSES["onboard_vehicle"], "--bind-link", ADDRESSES["onboard_link"]]
"""Options of an onboard process that is shown without a configuration."""
END_LIMIT_S = 60.0


def typed(command: str) -> bool:
    """Returns whether a command in running text is complete, and not the name of a subcommand or of an option."""
    words = words_of(command)
    if not words or words[0] in TOGETHER or (len(words) == 1 and words[0] not in BARE):
        return False
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            build_parser(words[0]).parse_args(words)
    except SystemExit as end:
        return not end.code
    return True


SHOWN = [command for _, command in BLOCKS] + [command for _, command in INLINE if typed(command)]
COMMANDS = list({tuple(words_of(command)) or command: command for command in SHOWN}.values())


def way_of(command: str) -> str:
    """Returns how a command is run here."""
    words = words_of(command)
    if not words:
        return "script"
    if "--help" in words or words[0] in ("config", "keygen"):
        return "cheap"
    return "together" if words[0] in TOGETHER else "alone"


def of(way: str) -> list[str]:
    return [command for command in COMMANDS if way_of(command) == way]


TOGETHER_PAGES = [page for page in PAGES if any(way_of(command) == "together" for command in block_commands(page))]


def short_form(command: str, address: str = "") -> list[str]:
    words = [re.sub(r"docs/data/.*\.parquet", PLACES["ROWS"], PLACES.get(word, word)) for word in words_of(command)]
    if "--scheduler" in words:
        words[words.index("--scheduler") + 1] = address
    added = SHORTER.get(words[0], [])
    if "--vehicle" in words:  # it has its own addresses
        added = [word for word in added if not word.startswith("--set")]
    return [*words, *added]


def test_every_kind_of_command_is_there() -> None:
    assert len(COMMANDS) > 40
    assert len(of("alone")) > 25
    assert {command.split()[0] for command in of("script")} <= NO_ARGUMENTS
    assert len(TOGETHER_PAGES) == 5


@pytest.mark.parametrize("command", of("cheap"))
def test_a_cheap_command_runs(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", io.StringIO("a passphrase, piped in\n"))
    make_key(command)
    try:
        status = main(words_of(command))
    except SystemExit as end:  # --help
        status = int(end.code or 0)
    assert status == 0


def make_key(command: str) -> None:
    for name in re.findall(r"key[_-]file[= ](\S+\.key)", command):
        if not Path(name).exists():
            assert main(["keygen", name]) == 0


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recorded flight, offboard and radio included."""
    folder = tmp_path_factory.mktemp("recorded") / "flight"
    assert main(["fly", "hover", "--lockstep", "--duration", "6", "--out", str(folder)]) == 0
    return folder


@pytest.fixture
def place(tmp_path: Path, flight: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder of a reader: a flight, a controller of their own, and small campaigns."""
    shutil.copytree(flight, tmp_path / "flight")
    page = (ROOT / "docs" / "control.md").read_text(encoding="utf-8")
    [controller] = re.findall(r"`toy_controller\.py`.*?```python\n(.*?)```", page, flags=re.DOTALL)
    [settings] = re.findall(r"`toy\.yaml`.*?```yaml\n(.*?)```", page, flags=re.DOTALL)
    (tmp_path / "toy_controller.py").write_text(controller, encoding="utf-8")
    (tmp_path / "toy.yaml").write_text(settings, encoding="utf-8")
    configs = tmp_path / "configs"
    shutil.copytree(CONFIG_DIRECTORY / "campaigns", configs / "campaigns")
    for path in (configs / "campaigns").glob("*.yaml"):
        path.write_text(yaml.safe_dump(small(yaml.safe_load(path.read_text(encoding="utf-8")))), encoding="utf-8")
    for module in (campaign_module, campaign_data):
        monkeypatch.setattr(module, "CONFIG_DIRECTORY", configs)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(ROOT), str(tmp_path))))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def small(campaign: dict[str, Any]) -> dict[str, Any]:
    """Returns the campaign with one short case, one controller, one step of each sweep and one figure."""
    case = campaign["cases"][0]
    if "case" in case:  # a tuning campaign
        return {**campaign, "cases": [{**case, "case": {**case["case"], "duration_s": 6.0}}]}
    first = {"points": lambda points: dict(list(points.items())[:1]), "values": lambda values: values[:1]}
    sweeps = [{k: first[k](v) if k in first else v for k, v in sweep.items()} for sweep in campaign.get("sweeps", [])]
    changed = {"cases": [{**case, "duration_s": 6.0}], "controllers": campaign["controllers"][-1:], "sweeps": sweeps}
    changed["figures"] = [{"kind": "compare", "metric": "position_rmse_m"}]
    dropped = ("targets", "traces", "compare_to", "same_conditions", "quick_seeds")
    return {key: value for key, value in campaign.items() if key not in dropped} | changed


@pytest.mark.full
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
@pytest.mark.parametrize("command", of("alone"))
def test_a_command_runs(command: str, place: Path) -> None:
    if "--scheduler" in command:
        with running_cluster(place) as address:
            assert main(short_form(command, address)) == 0
        return
    words = short_form(command)
    if words[0] == "view":
        run_view(words)
    elif words[0] == "preflight":
        run_preflight(words, place)
    else:
        if words[0] in ("figures", "refly"):
            assert main(short_form("dmrac campaign rotor_chip")) == 0
        if "--draw-only" in words:  # needs flights that were flown before
            assert main([word for word in words if word != "--draw-only"]) == 0
        assert main(words) == 0


def run_view(words: list[str]) -> None:
    """Serves the page and ends with Ctrl-C."""
    pytest.importorskip("flight_log.rerun_scene", reason="the viz extra is not installed")
    command = [sys.executable, "-m", "async_dmrac", *words, "--port", "0"]
    environment = {**os.environ, "BROWSER": "true"}  # opens no window
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as view:
        assert view.stdout is not None
        with urllib.request.urlopen(view.stdout.readline().strip(), timeout=END_LIMIT_S) as answer:
            assert b"canvas" in answer.read()
        view.send_signal(signal.SIGINT)
        assert view.wait(END_LIMIT_S) == 0


def run_preflight(words: list[str], place: Path) -> None:
    """Checks the simulated vehicle; on a busy machine its jitter may fail the check."""
    make_key(" ".join(words))
    assert main(short_form("dmrac config hover --out vehicle.yaml")) == 0
    with Processes(place) as processes:
        processes.start("sim", place / "vehicle.yaml")
        assert main(words) in (0, 1)


@pytest.mark.full
@pytest.mark.parametrize("page", TOGETHER_PAGES, ids=lambda page: page.name)
def test_the_processes_of_a_page_run_together(page: Path, place: Path) -> None:
    commands = dict.fromkeys(block_commands(page))
    for command in commands:
        make_key(command)
        if words_of(command)[:1] == ["config"] and "--help" not in command:
            assert main(short_form(command)) == 0
    words = [short_form(command) for command in commands if way_of(command) == "together"]
    with Processes(place) as processes:
        for name, *options in words:
            if name in processes.running:  # the page shows two ways to start it
                processes.end(name)
                assert processes.running[name].returncode == 0
            processes.start(name, *((place / "flight.yaml",) if "--config" in options else (None, *BINDS)), *options)
        if "sim" in processes.running:
            assert processes.wait("sim", END_LIMIT_S) == 0
        processes.end("onboard", "offboard")
        assert [processes.running[name].returncode for name in ("onboard", "offboard")] == [0, 0]


def test_no_script_passes_its_own_arguments_to_the_environment() -> None:
    """A file sourced without arguments sees the script's: `scripts/onboard --config x` would install an extra `x`."""
    for script in (ROOT / "scripts").iterdir():
        lines = script.read_text(encoding="utf-8").splitlines()
        assert all('/environment" with' in line for line in lines if line.startswith(". ")), script.name


@pytest.mark.full
@pytest.mark.parametrize("script", sorted((ROOT / "scripts").iterdir()), ids=lambda script: script.name)
def test_a_script_starts(script: Path) -> None:
    """`scripts/test --version` checks format, lint and types; pytest only prints its version."""
    if script.name == "environment":
        pytest.skip("sourced by the others")
    if not (ROOT / ".venv" / "installed-dev").exists():
        pytest.skip("the environment was not created by the scripts")
    option = "--version" if script.name == "test" else "--help"
    result = subprocess.run([script, option], capture_output=True, text=True, timeout=600, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
