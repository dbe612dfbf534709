"""Noise of the simulated sensors in hover beside real flight logs, and how well the estimator's sigmas fit it."""

from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np
from rich.table import Table
from scipy.signal import periodogram

from experiments.flights.lockstep_flight import LockstepOutcome, Observer, fly_lockstep
from experiments.flights.scenario import Choices, FlightConfig, resolve
from protocol.conventions import Array
from protocol.keys import load_key
from protocol.mavlink.frames import Fields, FrameReader
from protocol.mavlink.vehicle import FLOWS, IMU, RANGE, decode_flow, decode_imu, decode_range
from runtime.errors import PlainError
from sim_vehicle.lockstep import TickResult

BAND_HZ: Final = (3.0, 15.0)
"""Where the attitude loops act."""
HIGH_HZ: Final = 50.0
SETTLE_S: Final = 3.0
"""Cut from the start of the hover."""
NOT_MEASURED_S: Final = 12.0
"""Of a flight: take-off, SETTLE_S and landing."""
OUTLIER_M: Final = 0.15
"""A range that is off by more is an outlier, not noise."""
SCENARIOS: Final = ("hover", "figure8_calm", "figure8_wind")
"""Where the estimator's sigmas must fit."""
NIS: Final = (0.7, 1.3)
"""Least and greatest mean NIS of an aid whose sigma fits."""
TOLERANCE: Final = 0.25
LOGGED: Final[dict[str, tuple[float, float] | None]] = {
    "accelerometer x, m/s^2": (0.76, 0.76),
    "accelerometer y, m/s^2": (0.63, 0.63),
    "accelerometer z, m/s^2": (2.17, 2.17),
    "accelerometer x, 3-15 Hz, m/s^2": (0.02, 0.02),
    "accelerometer y, 3-15 Hz, m/s^2": (0.02, 0.02),
    "accelerometer z, 3-15 Hz, m/s^2": (0.11, 0.11),
    "accelerometer x, variance above 50 Hz": (0.90, 0.97),
    "accelerometer y, variance above 50 Hz": (0.90, 0.97),
    "accelerometer z, variance above 50 Hz": (0.90, 0.97),
    "gyro x, rad/s": (0.106, 0.106),
    "gyro y, rad/s": (0.164, 0.164),
    "tilt, deg": (0.63, 0.74),
    "pressure, Pa": (1.0, 4.0),
    "range, m": (0.012, 0.046),
    "flow x, rad/s": None,
    "flow y, rad/s": None,
}
"""Standard deviations, shares of the variance, and RMS of the tilt from level; least and greatest. None: no public log.

IMU and tilt: 200 Hz flight logs of a Rolling Spider, which has the same class of IMU, in hover in still air. Pressure
and range: flight logs of a Mambo. Range without outliers; flow after subtraction of the rotation, so with the motion.
"""


@dataclass(frozen=True)
class Row:
    """One quantity of the table."""

    quantity: str
    simulated: float
    logged: tuple[float, float] | None
    """Least and greatest. None: no public log."""
    fits: bool | None
    """Whether it is within 25 % of the logged range."""


@dataclass(frozen=True)
class Comparison:
    """Simulated against logged noise in hover, and mean NIS."""

    rows: list[Row]
    nis: dict[str, dict[str, float]]
    """By scenario and aid, over the whole time in the air; 1 where the estimator's sigma fits."""


@dataclass(frozen=True)
class Readings:
    """Readings of the vehicle in one flight, each with its time in s."""

    imu: list[tuple[float, ...]] = field(default_factory=list)
    """Accelerometer m/s^2, gyro rad/s, pressure Pa."""
    range: list[tuple[float, float]] = field(default_factory=list)
    """Error against the true height, m."""
    flow: list[tuple[float, float, float]] = field(default_factory=list)
    """Rate about x and y without rotation, rad/s."""

    def between(self, start_s: float, end_s: float) -> tuple[Array, Array, Array]:
        """[n, columns] of IMU, range and flow from start_s to end_s, without the times."""
        imu, distances, flow = (np.array(one) for one in (self.imu, self.range, self.flow))
        cut = [one[(one[:, 0] >= start_s) & (one[:, 0] <= end_s), 1:] for one in (imu, distances, flow)]
        return cut[0], cut[1], cut[2]


def compare_noise(choices: Choices) -> Comparison:
    """Fly SCENARIOS in lockstep. Raises PlainError if a flight crashes or the hover is too short."""
    nis, rows = {}, []
    for scenario in SCENARIOS:
        config, readings = resolve(scenario, choices), Readings()
        outcome = fly_lockstep(config, (_observer(config, readings),) if scenario == "hover" else ())
        if outcome.crash_reason:
            raise PlainError(f"{scenario}: the vehicle is lost: {outcome.crash_reason}")
        nis[scenario] = outcome.onboard["nis"]
        if scenario == "hover":
            rows = rows_of(noise_figures(readings, outcome))
    return Comparison(rows, nis)


def _observer(config: FlightConfig, readings: Readings) -> Observer:
    """Return a function that stores the readings of every tick."""
    reader = FrameReader([IMU, RANGE, *FLOWS], load_key(config.network.vehicle_key_file), tolerance_s=None)

    def store(message_id: int, fields: Fields, time_s: float, height_m: float) -> None:
        if message_id == IMU and (imu := decode_imu(fields)) is not None:
            readings.imu.append((time_s, *imu.accelerometer, *imu.gyroscope, imu.pressure_pa or np.nan))
        elif message_id == RANGE and (distance := decode_range(fields)) is not None:
            readings.range.append((time_s, distance.distance_m - height_m))
        elif message_id in FLOWS and (flow := decode_flow(fields)) is not None:
            rates = (flow.flow_x - flow.rotation_x, flow.flow_y - flow.rotation_y)
            readings.flow.append((time_s, rates[0] / flow.integration_s, rates[1] / flow.integration_s))

    def observe(result: TickResult) -> None:
        for datagram in result.from_vehicle:
            for frame in reader.read(datagram, 0):
                store(frame.message_id, frame.fields, result.now_ns * 1e-9, -float(result.truth[2]))

    return observe


def noise_figures(readings: Readings, outcome: LockstepOutcome) -> dict[str, float]:
    """Return the quantities of LOGGED. Raises PlainError if the hover is too short."""
    trace = outcome.trace
    hovering_s = trace.time_s[trace.on_path]
    if len(hovering_s) == 0 or hovering_s[-1] - hovering_s[0] < SETTLE_S + 1.0:
        raise PlainError("the vehicle did not hover long enough to measure it")
    start_s, end_s = hovering_s[0] + SETTLE_S, hovering_s[-1]
    imu, distances, flow = readings.between(start_s, end_s)
    total, band, high = imu.var(axis=0), band_variance(imu, *BAND_HZ), band_variance(imu, HIGH_HZ, np.inf)
    values = [*np.sqrt(total[:3]), *np.sqrt(band[:3]), *(high / total)[:3], *np.sqrt(total[3:5])]
    quaternion = trace.truth.vector("quaternion", "wxyz")[(trace.time_s >= start_s) & (trace.time_s <= end_s)]
    cosine = 1.0 - 2.0 * (quaternion[:, 1] ** 2 + quaternion[:, 2] ** 2)
    values.append(np.sqrt(np.mean(np.degrees(np.arccos(np.minimum(1.0, cosine))) ** 2)))
    values += [np.sqrt(total[6]), distances[np.abs(distances) < OUTLIER_M].std(), *flow.std(axis=0)]
    return {name: float(value) for name, value in zip(LOGGED, values, strict=True)}


def band_variance(samples: Array, low_hz: float, high_hz: float, rate_hz: float = 200.0) -> Array:
    """[columns] part of the variance of samples[n, columns] from low_hz up to high_hz."""
    frequency, spectrum = periodogram(samples, rate_hz, scaling="spectrum", axis=0)
    variance: Array = spectrum[(frequency >= low_hz) & (frequency < high_hz)].sum(axis=0)
    return variance


def rows_of(figures: dict[str, float]) -> list[Row]:
    """Return the rows of the table, in the order of LOGGED."""
    rows = []
    for name, logged in LOGGED.items():
        fits = None
        if logged is not None:
            fits = logged[0] * (1.0 - TOLERANCE) <= figures[name] <= logged[1] * (1.0 + TOLERANCE)
        rows.append(Row(name, figures[name], logged, fits))
    return rows


def noise_table(config: FlightConfig, rows: list[Row]) -> Table:
    """Return the table, simulated against logged."""
    title = f"sensors in hover: IMU noise {config.vehicle.sensors.imu.noise}, controller {config.controller}"
    table = Table(title=title, box=None, pad_edge=False, title_justify="left")
    table.add_column("quantity", no_wrap=True)
    for column in ("simulated", "logged", "within 25 %"):
        table.add_column(column, justify="right")
    for row in rows:
        table.add_row(row.quantity, f"{row.simulated:.3f}", *_logged(row))
    return table


def _logged(row: Row) -> tuple[str, str]:
    if row.logged is None:
        return "no log", "assumption"
    least, greatest = row.logged
    return f"{least:g}" if least == greatest else f"{least:g} to {greatest:g}", "yes" if row.fits else "no"


def nis_table(nis: dict[str, dict[str, float]]) -> Table:
    """Return the table of the mean NIS, aids in rows and scenarios in columns."""
    title = f"mean NIS of each aid, per dimension: {NIS[0]:g} to {NIS[1]:g} where the estimator's sigma fits"
    table = Table(title=title, box=None, pad_edge=False, title_justify="left")
    table.add_column("aid", no_wrap=True)
    for scenario in nis:
        table.add_column(scenario, justify="right")
    for aid in sorted({aid for means in nis.values() for aid in means}):
        table.add_row(aid, *(f"{means[aid]:.2f}" if aid in means else "-" for means in nis.values()))
    return table


def as_json(config: FlightConfig, comparison: Comparison) -> dict[str, Any]:
    """Return the tables for programs."""
    return {
        "noise": config.vehicle.sensors.imu.noise,
        "controller": config.controller,
        "seed": config.seed,
        "rows": [asdict(row) for row in comparison.rows],
        "nis": comparison.nis,
    }
