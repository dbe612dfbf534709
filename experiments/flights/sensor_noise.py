"""Noise of the simulated IMU in hover, beside the figures of real flight logs."""

from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from rich.table import Table

from experiments.flights.lockstep_flight import LockstepOutcome, fly_lockstep
from experiments.flights.scenario import FlightConfig
from protocol.conventions import Array
from protocol.keys import load_key
from protocol.mavlink.frames import FrameReader
from protocol.mavlink.vehicle import IMU, decode_imu
from runtime.errors import PlainError
from sim_vehicle.lockstep import TickResult

BAND_HZ: Final = (3.0, 15.0)
"""Where the attitude loops act."""
HIGH_HZ: Final = 50.0
SETTLE_S: Final = 3.0
"""Cut from the start of the hover."""
NOT_MEASURED_S: Final = 12.0
"""Of a flight: take-off, SETTLE_S and landing."""
TOLERANCE: Final = 0.25
LOGGED: Final[dict[str, tuple[float, float]]] = {
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
}
"""Standard deviations, shares of the variance, and RMS of the tilt from level; least and greatest.

200 Hz flight logs of a Rolling Spider, which has the same class of IMU, in hover in still air.
"""


@dataclass(frozen=True)
class Row:
    """One quantity of the table."""

    quantity: str
    simulated: float
    logged: tuple[float, float]
    """Least and greatest."""
    fits: bool
    """Whether it is within 25 % of the logged range."""


def compare_noise(config: FlightConfig) -> list[Row]:
    """Fly the hover of `config` in lockstep and compare its IMU with LOGGED. Raises PlainError if it crashes."""
    reader = FrameReader([IMU], load_key(config.network.vehicle_key_file), tolerance_s=None)
    readings: list[tuple[float, ...]] = []

    def observe(result: TickResult) -> None:
        for datagram in result.from_vehicle:
            for frame in reader.read(datagram, 0):
                reading = decode_imu(frame.fields)
                if reading is not None:
                    readings.append((result.now_ns * 1e-9, *reading.accelerometer, *reading.gyroscope))

    outcome = fly_lockstep(config, (observe,), with_offboard=True)
    if outcome.crash_reason:
        raise PlainError(f"the vehicle is lost: {outcome.crash_reason}")
    return rows_of(noise_figures(np.array(readings), outcome))


def noise_figures(readings: Array, outcome: LockstepOutcome) -> dict[str, float]:
    """Return the quantities of LOGGED. readings: [n, 7] time in s, accelerometer, gyro."""
    trace = outcome.trace
    hovering_s = trace.time_s[trace.on_path]
    if len(hovering_s) == 0 or hovering_s[-1] - hovering_s[0] < SETTLE_S + 1.0:
        raise PlainError("the vehicle did not hover long enough to measure it")
    start_s, end_s = hovering_s[0] + SETTLE_S, hovering_s[-1]
    time_s = readings[:, 0]
    imu = readings[(time_s >= start_s) & (time_s <= end_s), 1:]
    total, band, high = imu.var(axis=0), band_variance(imu, *BAND_HZ), band_variance(imu, HIGH_HZ, np.inf)
    values = [*np.sqrt(total[:3]), *np.sqrt(band[:3]), *(high / total)[:3], *np.sqrt(total[3:5])]
    quaternion = trace.truth.vector("quaternion", "wxyz")[(trace.time_s >= start_s) & (trace.time_s <= end_s)]
    cosine = 1.0 - 2.0 * (quaternion[:, 1] ** 2 + quaternion[:, 2] ** 2)
    values.append(np.sqrt(np.mean(np.degrees(np.arccos(np.minimum(1.0, cosine))) ** 2)))
    return {name: float(value) for name, value in zip(LOGGED, values, strict=True)}


def band_variance(samples: Array, low_hz: float, high_hz: float, rate_hz: float = 200.0) -> Array:
    """[columns] part of the variance of samples[n, columns] from low_hz up to high_hz."""
    n = len(samples)
    spectrum = np.abs(np.fft.rfft(samples - samples.mean(axis=0), axis=0)) ** 2
    spectrum[1 : (n + 1) // 2] *= 2.0
    frequency = np.fft.rfftfreq(n, 1.0 / rate_hz)
    variance: Array = spectrum[(frequency >= low_hz) & (frequency < high_hz)].sum(axis=0) / n**2
    return variance


def rows_of(figures: dict[str, float]) -> list[Row]:
    """Return the rows of the table, in the order of LOGGED."""
    rows = []
    for name, (least, greatest) in LOGGED.items():
        fits = least * (1.0 - TOLERANCE) <= figures[name] <= greatest * (1.0 + TOLERANCE)
        rows.append(Row(name, figures[name], (least, greatest), fits))
    return rows


def noise_table(config: FlightConfig, rows: list[Row]) -> Table:
    """Return the table, simulated against logged."""
    title = f"IMU in hover: noise {config.vehicle.sensors.imu.noise}, controller {config.controller}"
    table = Table(title=title, box=None, pad_edge=False, title_justify="left")
    table.add_column("quantity", no_wrap=True)
    for column in ("simulated", "logged", "within 25 %"):
        table.add_column(column, justify="right")
    for row in rows:
        least, greatest = row.logged
        logged = f"{least:g}" if least == greatest else f"{least:g} to {greatest:g}"
        table.add_row(row.quantity, f"{row.simulated:.3f}", logged, "yes" if row.fits else "no")
    return table


def as_json(config: FlightConfig, rows: list[Row]) -> dict[str, Any]:
    """Return the table for programs."""
    return {
        "noise": config.vehicle.sensors.imu.noise,
        "controller": config.controller,
        "seed": config.seed,
        "rows": [asdict(row) for row in rows],
    }
