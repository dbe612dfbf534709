"""Stores the rows of a campaign: one Parquet file, and a journal of the rows since it was last rewritten.

Theory of operation. Rows cannot be appended to a Parquet file. So each row is first written as a line of JSON to
flights.journal and flushed to the disk. From time to time the journal is merged into flights.parquet: a new file is
written beside the old one and renamed over it, then the journal is deleted. No reported row is lost, whenever the
process dies: an incomplete last line belongs to a flight that was not reported; a row that is in both files (death
between rename and deletion) counts once, by its key.
"""

import json
from pathlib import Path
from typing import Any, BinaryIO, Final

import pyarrow as pa
import pyarrow.parquet as pq

from experiments.campaigns.flight_row import SCHEMA, Row
from runtime.files import append_json, sync_folder, write_atomically

PARQUET: Final = "flights.parquet"
JOURNAL: Final = "flights.journal"
MERGE_EVERY: Final = 500
"""Rows in the journal before it is merged into the Parquet file."""


class CampaignStore:
    """Rows of one campaign folder. One process at a time: the folder is locked while it is open."""

    def __init__(self, folder: Path) -> None:
        """Raise BlockingIOError if another process has the folder open."""
        import fcntl

        folder.mkdir(parents=True, exist_ok=True)
        self._lock = (folder / ".lock").open("w")
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._lock.close()
            raise
        self._folder = folder
        self.done: set[str] = set()
        """Keys of the flights that are done."""
        self._merge()
        self._journal = self._open_journal()
        self._waiting = 0

    def append(self, row: Row) -> None:
        """Store one row; it is on the disk when this returns."""
        append_json(self._journal, row)
        self.done.add(row["key"])
        self._waiting += 1
        if self._waiting >= MERGE_EVERY:
            self._journal.close()
            self._merge()
            self._journal = self._open_journal()
            self._waiting = 0

    def close(self) -> None:
        """Merge the journal and release the folder."""
        self._journal.close()
        self._merge()
        self._lock.close()

    def _open_journal(self) -> BinaryIO:
        journal = (self._folder / JOURNAL).open("ab")
        sync_folder(self._folder)
        return journal

    def _merge(self) -> None:
        rows = read_table(self._folder)
        self.done = set(rows.column("key").to_pylist())
        journal = self._folder / JOURNAL
        if journal.exists() and journal.stat().st_size:
            write_table(self._folder / PARQUET, rows)
            journal.unlink()


def read_table(folder: Path) -> pa.Table:
    """Return all rows, with those of the journal, each key once (the newest row)."""
    parquet = folder / PARQUET
    table = pq.read_table(parquet, schema=SCHEMA) if parquet.exists() else SCHEMA.empty_table()
    fresh = {row["key"]: row for row in _journal_rows(folder / JOURNAL)}
    if not fresh:
        return table
    old = pa.array([key not in fresh for key in table.column("key").to_pylist()], type=pa.bool_())
    return pa.concat_tables([table.filter(old), pa.Table.from_pylist(list(fresh.values()), schema=SCHEMA)])


def _journal_rows(path: Path) -> list[dict[str, Any]]:
    if not path.exists():
        return []
    rows = []
    for line in path.read_bytes().split(b"\n"):
        try:
            row = json.loads(line)
        except ValueError:
            continue  # incomplete, the writer died: that flight was not reported
        if isinstance(row, dict) and set(SCHEMA.names) >= set(row) and "key" in row:
            rows.append(row)
    return rows


def drop_failed(folder: Path) -> None:
    """Delete the rows of failed flights, so that these are repeated."""
    table = read_table(folder)
    keep = pa.array([not error for error in table.column("error").to_pylist()], type=pa.bool_())
    write_table(folder / PARQUET, table.filter(keep))
    (folder / JOURNAL).unlink(missing_ok=True)


def write_table(path: Path, table: pa.Table) -> None:
    """Write a Parquet file, complete or not at all."""
    content = pa.BufferOutputStream()
    pq.write_table(table, content, compression="zstd")
    write_atomically(path, content.getvalue().to_pybytes())
