"""What a Python program gets of a flight or a campaign: arrays with named columns and units, metrics, figures, events.

pandas, pyarrow and matplotlib are imported by the functions that need them, and not before.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import flight_log.reader as reader
from configs.loader import fill_section, read_tree
from configs.parts import part_names
from experiments.flights.metrics import FlightMetrics, flight_metrics
from experiments.flights.trace import FlightTrace, trace_of
from flight_log.reader import FlightError
from onboard.flight.trajectory import TrajectoryConfig
from runtime.extras import require_modules

if TYPE_CHECKING:
    import matplotlib.figure
    import pandas as pd
    import pyarrow as pa

__all__ = ["CampaignResult", "Flight", "Table"]


@dataclass(frozen=True, slots=True)
class Table(reader.Table):
    """All records of a topic: `table["position_n"]` [n], `table.units["position_n"]`, `table.time_s` [n]."""

    start_ns: int = 0
    """Time of the flight's t = 0."""

    @property
    def time_s(self) -> NDArray[np.float64]:
        """[n], s since the flight's t = 0."""
        return self.seconds(self.start_ns)

    def to_pandas(self) -> "pd.DataFrame":
        """Return a DataFrame with one column per quantity, indexed by `time_s`; its `attrs["units"]` has the units.

        Raises
        ------
        MissingExtraError
            If pandas is not installed.
        """
        require_modules("pandas", purpose="to_pandas")
        import pandas

        frame: pd.DataFrame = pandas.DataFrame(self.columns, index=pandas.Index(self.time_s, name="time_s"))
        frame.attrs["units"] = dict(self.units)
        return frame

    def to_arrow(self) -> "pa.Table":
        """Return a pyarrow Table: `time_s`, then one column per quantity; the metadata of a field has its unit.

        Raises
        ------
        MissingExtraError
            If pyarrow is not installed.
        """
        require_modules("pyarrow", purpose="to_arrow")
        import pyarrow as arrow

        units = {"time_s": "s", **self.units}
        schema = arrow.schema([arrow.field(name, arrow.float64(), metadata={"unit": units[name]}) for name in units])
        arrays = {"time_s": self.time_s, **self.columns}
        return arrow.table({name: np.ascontiguousarray(column) for name, column in arrays.items()}, schema=schema)


class Flight(reader.Flight):
    """A recorded flight: `flight["onboard/tick"]` is a Table, `flight.topics` lists them all.

    `summary` (dict), `events` (time_ns, process, text), `path`, `start_ns`, `duration_s`, `gaps` and `faults` as in
    flight_log.reader.Flight.
    """

    def __getitem__(self, topic: str) -> Table:
        """Return the table of a topic. Raises KeyError, which lists the topics."""
        found = super().__getitem__(topic)
        if isinstance(found, Table):
            return found
        parts = found.topic, found.names, found.units, found.time_ns, found.values
        # t = 0 is the first record of onboard/tick, so asking for `start_ns` while that topic is built would not end.
        start_ns = int(found.time_ns[0]) if topic == reader.TICK_TOPIC else self.start_ns
        self._tables[topic] = table = Table(*parts, start_ns=start_ns)
        return table

    @cached_property
    def config(self) -> dict[str, Any]:
        """The whole configuration that was flown, as a plain tree. Raises ConfigError if it cannot be read."""
        return read_tree(self._folder / "config.yaml")

    @cached_property
    def trace(self) -> FlightTrace:
        """Ticks and truth at the same times: `on_path`, `position_error` [n, 3] m, `true_delta` [n, 6].

        Raises
        ------
        FlightError
            If the flight has no log of onboard or of the simulated vehicle.
        """
        trace = trace_of(self)
        if trace is None:
            raise FlightError(f"{self.path}: no log of onboard's ticks, or none of the simulated vehicle's truth")
        return trace

    @cached_property
    def metrics(self) -> FlightMetrics:
        """Position RMSE [m], attitude RMSE [rad], and RMSE of each lap [m]. Raises FlightError as `trace` does."""
        guidance = self.config["onboard"]["guidance"]
        trajectory = fill_section(TrajectoryConfig, guidance, f"{self._folder / 'config.yaml'}", "trajectory")
        return flight_metrics(self.trace, trajectory)

    @property
    def survived(self) -> bool:
        """Whether the vehicle was alive at the end."""
        return bool(self.summary.get("survived", False))

    def figure(self) -> "matplotlib.figure.Figure":
        """Draw path, errors, attitude, nu_ad, weights and link. Raises FlightError as `trace` does.

        Raises
        ------
        MissingExtraError
            If matplotlib is not installed.
        """
        require_modules("matplotlib", purpose="figure")
        from experiments.flights.flight_figure import flight_figure
        from experiments.flights.logged_flight import lost_datagrams

        about = self.summary
        title = ", ".join(str(about.get(key, "?")) for key in ("scenario", "controller", "seed", "mode"))
        figure: matplotlib.figure.Figure = flight_figure(self.trace, title, lost_datagrams(self._folder))
        return figure

    @property
    def _folder(self) -> Path:
        return self.path if self.path.is_dir() else self.path.parent

    def __repr__(self) -> str:
        return f"Flight({str(self.path)!r}, {self.duration_s:.1f} s, topics: {', '.join(self.topics)})"


@dataclass(frozen=True)
class CampaignResult:
    """The flights of a campaign, one row each."""

    folder: Path
    total: int
    """Flights that the campaign has."""
    flown: int
    """Flights that this call has flown."""
    lost: int
    """Of these, how many vehicles were lost."""
    errors: int
    """Of these, how many could not be flown; the column `error` says why."""

    def to_arrow(self) -> "pa.Table":
        """Return all rows as a pyarrow Table; the columns are those of experiments.campaigns.flight_row.SCHEMA."""
        require_modules("pyarrow", purpose="to_arrow")
        from experiments.campaigns.store import read_table

        return read_table(self.folder)

    def to_pandas(self) -> "pd.DataFrame":
        """Return all rows as a DataFrame. Raises MissingExtraError if pandas is not installed."""
        require_modules("pandas", purpose="to_pandas")
        frame: pd.DataFrame = self.to_arrow().to_pandas()
        return frame

    def tables(self) -> str:
        """Return the tables of the results page about these flights, as Markdown."""
        require_modules("pyarrow", purpose="tables")
        from experiments.results.campaign_data import load_data
        from experiments.results.tables import tables

        return "\n".join(table.markdown() for table in tables(load_data(self.folder)))

    def __getitem__(self, column: str) -> NDArray[Any]:
        """Return one column of all rows, [n]. Raises KeyError, which lists the columns."""
        rows = self.to_arrow()
        if column not in rows.column_names:
            raise KeyError(f"no column {column!r}; there are {', '.join(rows.column_names)}")
        return np.array(rows.column(column).to_pylist())

    def groups(self, column: str, by: tuple[str, ...] = ("case", "controller", "point")) -> Mapping[Any, NDArray[Any]]:
        """Return the values of a column, [n] each, by the values of the `by` columns."""
        values, keys = self[column], list(zip(*(self[name].tolist() for name in by), strict=True))
        return {key: values[[one == key for one in keys]] for key in dict.fromkeys(keys)}


def scenarios() -> list[str]:
    """Return the names of the shipped scenarios."""
    return part_names("scenarios")


def controllers() -> list[str]:
    """Return the names of the shipped controllers."""
    return part_names("controllers")
