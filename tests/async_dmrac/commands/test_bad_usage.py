"""Bad usage gives one line with the input and what is allowed, and status 2; nothing is started or left behind."""

from pathlib import Path

import pytest

from async_dmrac.command_line import main
from flight_log import viewer


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("fly nowhere", "unknown scenario 'nowhere': allowed are blackout, "),
        ("fly --controller magic", "unknown controller 'magic': allowed are bias, "),
        ("fly --duration -3", "--duration -3.0: Input should be greater than or equal to 5"),
        ("fly --duration nan", "--duration nan: "),
        ("fly --seed -1", "--seed -1: Input should be greater than or equal to 0"),
        ("fly --set x", "--set x: expected path.to.key=value"),
        ("fly --set foo.bar=1", "foo: unknown key; allowed are controller, "),
        ("fly --set onboard.airframe.mass_kg=-1", "onboard.airframe.mass_kg: -1: Input should be greater than 0"),
        ("fly --set onboard.controller.settings.x=1", "--set onboard.controller.settings.x=1: controller.settings.x"),
        ("fly --set network.key_file=none.key", "none.key: cannot be read"),
        ("fly --web", "--web: only with --view"),
        ("fly --vehicle 0", "--vehicle 0: Input should be greater than or equal to 1"),
        ("demo --out demo.txt", "--out demo.txt: expected a name that ends in .png, .svg or .pdf"),
        ("demo --out no/such/demo.png", "--out no/such/demo.png: there is no folder no/such"),
        ("demo --duration 3", "--duration 3.0: Input should be greater than or equal to 5"),
        ("fly --view --json", "--json: not with --view, which prints its address"),
        ("fly --view --lockstep", "--view: only in real time"),
        ("config --out no/such/folder.yaml", "no/such/folder.yaml: No such file or directory"),
        ("config --vehicle 0", "--vehicle 0: Input should be greater than or equal to 1"),
        ("config --vehicle 101", "--vehicle 101: Input should be less than or equal to 100"),
        ("bench --seconds 0", "--seconds 0: allowed are 2 to 600"),
        ("bench sensors --seconds 1", "--seconds 1: allowed are 2 to 600"),
        (
            "bench sensors --set vehicle.sensors.imu.noise=pink",
            "imu.noise: 'pink': Input should be 'white' or 'measured'",
        ),
        ("bench no_such_scenario", "unknown scenario 'no_such_scenario': allowed are blackout, "),
        ("tune magic --controller pid --trials 1", "unknown campaign 'magic': allowed are ablations, "),
        ("campaign magic", "unknown campaign 'magic': allowed are ablations, "),
        ("attack --case magic", "--case: 'magic' unknown; allowed are silent, "),
        ("attack --condition storm --out there", "--condition: 'storm' unknown; allowed are scenario, calm, "),
        ("attack --condition jet_8 --scenario hover", "scenario hover has none"),
        ("attack --search 3 --first-seed 1000 --out there", "seed 1000 is for evaluation; allowed are 0 to 999"),
        ("attack --keep", "--keep: writes what a search has found; expected --search N as well"),
        ("attack --search 3 --case steep", "--case: a search makes its own"),
        ("refly nothing", "nothing: not a campaign's folder: there is no campaign.yaml"),
        ("replay nothing", "nothing: no such flight"),
        ("view nothing --save x.rrd", "nothing: no such flight"),
    ],
)
def test_bad_usage_is_one_line(
    words: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words.split()) == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.err.startswith(f"dmrac {words.split()[0]}: ")
    assert captured.err.count("\n") == 1
    assert captured.out == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "option"),
    [
        ("campaign rotor_chip --jobs 0", "--jobs"),
        ("campaign rotor_chip --seeds 0", "--seeds"),
        ("refly nothing --sample 0", "--sample"),
        ("reproduce --seeds -5", "--seeds"),
        ("dropouts --jobs -1", "--jobs"),
        ("tune tune --controller pid --trials 3 --jobs 0", "--jobs"),
        ("tune tune --controller pid --trials 0", "--trials"),
    ],
)
def test_a_number_is_at_least_one(words: str, option: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words.split())
    assert ended.value.code == 2
    assert f"argument {option}: at least 1" in capsys.readouterr().err


def test_nothing_is_flown_without_the_viewer_that_was_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(viewer.importlib.util, "find_spec", lambda name: None)
    assert main(["fly", "--view"]) == 2
    assert capsys.readouterr().err.startswith("dmrac fly: --view: the viewer is not installed")
    assert list(tmp_path.iterdir()) == []
