"""Compressed chunks: the records come back to the bit, damage is reported, and a flight's log is small."""

from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from flight_log import mcap_file
from flight_log.chunk_columns import CHUNK_MAX_BYTES, COLUMNS, PLAIN_ZSTD, compressed, compressed_columns, restored
from flight_log.reader import open_flight
from flight_log.schema import RecordType
from flight_log.writer import FlightLogWriter

VECTORS = Path(__file__).resolve().parents[1] / "vectors"
tables = st.lists(st.tuples(st.integers(1, 9), st.integers(1, 40)), min_size=1, max_size=5)


@given(tables, st.randoms(use_true_random=False))
def test_all_bytes_come_back(shapes: list[tuple[int, int]], random) -> None:  # type: ignore[no-untyped-def]
    found = [(rows, random.randbytes(rows * width)) for rows, width in shapes]
    records = b"".join(data for _, data in found)
    assert restored(COLUMNS, compressed_columns(found), len(records)) == records
    assert restored(PLAIN_ZSTD, compressed(records), len(records)) == records
    assert restored("", records, len(records)) == records


@given(st.binary(max_size=200), st.sampled_from((COLUMNS, PLAIN_ZSTD, "lz4")))
def test_any_bytes_are_refused_with_a_valueerror(data: bytes, compression: str) -> None:
    with pytest.raises(ValueError, match=r"chunk|unpack"):
        restored(compression, data, 10**6)


@pytest.mark.parametrize("size", [100, CHUNK_MAX_BYTES + 1])
def test_a_small_chunk_cannot_become_a_large_one(size: int) -> None:
    bomb = zstandard.ZstdCompressor().compress(bytes(400_000_000))
    assert len(bomb) < 100_000
    with pytest.raises(ValueError, match="chunk"):
        restored(PLAIN_ZSTD, bomb, size)


TICK = RecordType("onboard/tick", tuple((f"value_{number}", "m") for number in range(60)), "float32")


def logged_bytes(path: Path) -> int:
    rng = np.random.default_rng(1)
    values = np.cumsum(rng.normal(0.0, 1e-3, (1200, 60)), axis=0)
    with FlightLogWriter(path, "onboard", threaded=False) as log:
        for tick, row in enumerate(values):
            log.write(TICK, tick * 5_000_000, row)
    read = open_flight(path)["onboard/tick"].values
    np.testing.assert_array_equal(read, values.astype(np.float32))
    return path.stat().st_size


def test_a_log_takes_a_third_of_the_plain_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = logged_bytes(tmp_path / "small.mcap")
    assert small < 0.4 * 1200 * (60 * 8 + 35)
    monkeypatch.setattr(mcap_file, "compressed_columns", lambda tables: compressed(b"".join(one for _, one in tables)))
    monkeypatch.setattr(mcap_file, "COLUMNS", PLAIN_ZSTD)
    assert logged_bytes(tmp_path / "by_rows.mcap") > 1.1 * small, "columns are what makes it small"


def test_a_log_of_the_first_format_still_opens() -> None:
    flight = open_flight(VECTORS / "flight_log_v1.mcap")
    tick = flight["onboard/tick"]
    assert tick.time_ns.tolist() == [number * 5_000_000 for number in range(40)]
    assert tick["position_d"].tolist() == [0.1 * number for number in range(40)]
    assert [event.text for event in flight.events] == ["armed"]
    assert flight.messages("onboard/received") == [(18, b"\x01\x02")]
    assert flight.attachments["onboard"] == {"config.yaml": b"a: 1\n"}
    assert flight.faults == ()
