"""The flights of an attack campaign, one line of JSON each: what is there is not flown again.

The first line says which code and settings flew. Flights of other ones are not mixed with them.
"""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from configs.loader import ConfigError
from experiments.attacks.attack_flight import AttackFlight, AttackOutcome
from runtime.files import append_json

FILE: Final = "attacks.jsonl"


def _key(flight: AttackFlight) -> str:
    """Name of a flight: all that it depends on but the code."""
    text = json.dumps(asdict(flight), sort_keys=True)
    return f"{flight.case}/{flight.condition}/{flight.seed}/{hashlib.blake2b(text.encode(), digest_size=6).hexdigest()}"


class Journal:
    """Outcomes by flight, on the disk as soon as they are known. Without a folder, in memory only."""

    def __init__(self, folder: Path | None, source: str) -> None:
        """source: the code that flies, such as a commit. Raises ConfigError: other code, or a file that is none."""
        self._done: dict[str, AttackOutcome] = {}
        self._path = None if folder is None else folder / FILE
        if self._path is None:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        lines = self._complete_lines()
        if lines:
            self._require_same(lines[0], source)
        else:
            self._write({"source": source})
        for number, line in enumerate(lines[1:], start=2):
            try:
                entry = json.loads(line)
                outcome = dict(entry["outcome"])
                outcome["refused"] = {int(version): reason for version, reason in outcome["refused"].items()}
                self._done[entry["key"]] = AttackOutcome(**outcome)
            except (ValueError, KeyError, TypeError) as error:
                raise ConfigError(f"{self._path}, line {number}: no flight of an attack: {error}") from None

    def _complete_lines(self) -> list[str]:
        """The lines of the file; what follows the last line end is of a process that was killed, and is cut off."""
        assert self._path is not None
        if not self._path.exists():
            return []
        content = self._path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if len(whole) < len(content):
            self._path.write_bytes(whole)
        return whole.decode(errors="replace").splitlines()

    def _require_same(self, line: str, source: str) -> None:
        try:
            flown = json.loads(line)["source"]
        except (ValueError, KeyError, TypeError):
            raise ConfigError(f"{self._path}: not the journal of dmrac attack; choose another --out") from None
        if flown != source:
            raise ConfigError(f"{self._path}: flown with {flown!r}, this is {source!r}; choose another --out")

    def _write(self, entry: dict[str, Any]) -> None:
        if self._path is None:
            return
        with self._path.open("ab") as file:
            append_json(file, entry)

    def find(self, flight: AttackFlight) -> AttackOutcome | None:
        """The outcome of a flight, if it has been flown."""
        return self._done.get(_key(flight))

    def add(self, flight: AttackFlight, outcome: AttackOutcome) -> None:
        """Store an outcome. Raises OSError."""
        key = _key(flight)
        self._done[key] = outcome
        self._write({"key": key, "outcome": asdict(outcome)})
