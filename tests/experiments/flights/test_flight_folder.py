"""A flight that does not start leaves nothing but a long error report."""

from pathlib import Path

from experiments.flights.flight_folder import clear_folder, make_folder


def fill(folder: Path, errors: str) -> None:
    for name in ("config.yaml", "sim_vehicle.mcap", "sim_summary.json"):
        (folder / name).write_text("x", encoding="utf-8")
    (folder / "sim_errors.txt").write_text("", encoding="utf-8")
    (folder / "offboard_errors.txt").write_text(errors, encoding="utf-8")


def test_one_line_is_printed_and_not_stored(tmp_path: Path) -> None:
    folder = make_folder(tmp_path / "flights" / "one", "hover")
    fill(folder, "offboard.labels: unknown key\n")
    assert clear_folder(folder) == ""
    assert not folder.exists()


def test_a_long_report_is_stored_and_named(tmp_path: Path) -> None:
    folder = make_folder(tmp_path / "one", "hover")
    fill(folder, "Traceback\n  line\nMemoryError\n")
    assert clear_folder(folder) == f"; its full output is in {folder / 'offboard_errors.txt'}"
    assert [path.name for path in folder.iterdir()] == ["offboard_errors.txt"]


def test_earlier_files_stay(tmp_path: Path) -> None:
    earlier = tmp_path / "onboard.mcap"
    earlier.write_bytes(b"an earlier flight that was cut off")
    folder = make_folder(tmp_path, "hover")
    kept = tuple(folder.iterdir())
    fill(folder, "")
    assert clear_folder(folder, kept) == ""
    assert list(folder.iterdir()) == [earlier]
