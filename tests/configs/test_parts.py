"""Parts by name: files that extend others, families of variants, and the values that the shipped files repeat."""

from pathlib import Path

import pytest

from configs.loader import ConfigError, fill
from configs.parts import named_file, part_names, read_part
from sim_vehicle.link.radio import RadioConfig

RADIO = ["bad", "bluetooth", "good", "medium", "perfect"]
BLACKOUTS = [f"blackout_{name}" for name in ("10s", "1s", "300ms", "3s", "to_end")]


def written(folder: Path, **files: str) -> None:
    for name, text in files.items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")


def test_a_family_of_variants_holds_a_part_for_each() -> None:
    assert part_names("radio") == sorted(RADIO + BLACKOUTS)
    assert {"loss_30", "burst_5", "blackout_3s", "dead"} < set(part_names("dropouts"))
    assert named_file("radio", "blackout_to_end").name == "blackout.yaml"
    good, silent = (fill(RadioConfig, read_part("radio", name), name) for name in ("good", "blackout_3s"))
    assert silent.up.blackouts == silent.down.blackouts
    assert (silent.up.blackouts[0].start_s, silent.up.blackouts[0].end_s) == (12.0, 15.0)
    assert silent.up.model_copy(update={"blackouts": ()}) == good.up


def test_a_file_extends_the_one_beside_it(tmp_path: Path) -> None:
    written(tmp_path, low="a: {b: 1, c: 2}\nd: [1, 2]", middle="extends: low.yaml\na: {b: 3}")
    written(tmp_path, high="extends: middle.yaml\nd: [3]")
    assert read_part("vehicles", str(tmp_path / "high.yaml")) == {"a": {"b": 3, "c": 2}, "d": [3]}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("extends: odd.yaml", r"odd\.yaml: extends: these extend each other: .*odd\.yaml"),
        ("extends: no_such", r"odd\.yaml: extends: unknown vehicle 'no_such': allowed are mambo, mambo_real, or the"),
        ("extends: [mambo]", r"odd\.yaml: extends: \['mambo'\]: expected the name of a vehicle"),
        ("variants: {a: 1}", r"odd\.yaml: variants: expected a mapping"),
        ("variants: {a: {}}", r"unknown vehicle '.*odd\.yaml': allowed are mambo, "),
    ],
)
def test_what_is_wrong_is_named(text: str, said: str, tmp_path: Path) -> None:
    written(tmp_path, odd=text)
    with pytest.raises(ConfigError, match=said):
        read_part("vehicles", str(tmp_path / "odd.yaml"))


@pytest.mark.parametrize("name", ["blackout", "blackout_2s", "blackout_", "_"])
def test_a_family_is_no_part_itself(name: str) -> None:
    with pytest.raises(ConfigError, match=f"unknown radio '{name}': allowed are bad, blackout_10s, "):
        read_part("radio", name)


def test_what_one_direction_says_wins_over_what_both_say() -> None:
    radio = fill(RadioConfig, {"both": {"loss": 0.1, "burst": {"leave": 0.5}}, "up": {"burst": {"enter": 0.2}}}, "t")
    assert (radio.up.loss, radio.up.burst.enter, radio.up.burst.leave) == (0.1, 0.2, 0.5)
    assert (radio.down.loss, radio.down.burst.enter) == (0.1, 0.0)
    with pytest.raises(ConfigError, match=r"radio\.up\.los: unknown key"):
        fill(RadioConfig, {"both": {"los": 0.1}}, "t", "radio.")
    with pytest.raises(ConfigError, match=r"radio\.both: unknown key; allowed are down, up"):
        fill(RadioConfig, {"both": 0.1}, "t", "radio.")
