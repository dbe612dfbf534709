"""Measures the open loops of a controller in flight, with adaptation running.

A small multi-sine d is added to the demand u of a channel, after the law. The controller does not know it. Broken at
that point, the loop is L = -U / (U + D): U and D are the Fourier coefficients of u and d at the frequencies of d. Each
axis has frequencies of its own, so all axes of a channel are measured in one flight.
"""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from experiments.flights.lockstep_flight import build
from experiments.flights.scenario import FlightConfig
from experiments.margins.stability import Complex, Margins, margins
from onboard.control.interface import Controller
from onboard.control.records import ControlInputs, ControlOutput
from onboard.flight.modes import FlightMode
from protocol.conventions import Array

LOOPS: Final = (("north", "east", "down"), ("roll", "pitch", "yaw"))
"""Axes of the position and of the attitude channel."""
ZERO: Final = (0.0, 0.0, 0.0)


class Band(NamedTuple):
    """How a channel is excited."""

    low_hz: float
    high_hz: float
    tones: int
    """Per axis."""
    amplitude: float
    """Of each tone: m/s^2 or rad/s^2."""
    period_s: float
    """Of the multi-sine: all tones are multiples of its inverse."""
    periods: int
    """Measured, after one that is not."""


TAKE_OFF_AND_LANDING_S: Final = 14.0
BANDS: Final = (Band(0.1, 4.0, 14, 0.06, 20.0, 3), Band(0.6, 24.0, 18, 1.2, 10.0, 4))


class Response(NamedTuple):
    """The measured loop of one axis."""

    loop: str
    omega: Array
    """[n], rad/s."""
    L: Complex
    """[n]"""

    @property
    def margins(self) -> Margins:
        """Its margins."""
        return margins(self.omega, self.L)


def flight_time_s() -> float:
    """Time of the longer of the two flights, with take-off and landing, s."""
    return max((band.periods + 1) * band.period_s for band in BANDS) + TAKE_OFF_AND_LANDING_S


class LoopMeasurementError(Exception):
    """The flight ended before the measurement was complete."""


class Excited:
    """A controller with an excitation of one channel; records u and d of that channel."""

    def __init__(self, controller: Controller, channel: int, excitation: Array) -> None:
        """excitation: [n, 3], tick by tick from the first tick of FLYING."""
        self._controller = controller
        self._channel = channel
        self._excitation = excitation
        self.demand: Array = np.zeros_like(excitation)
        self.flying = False
        self.ticks = 0

    def step(self, inputs: ControlInputs) -> ControlOutput:
        """One tick, excited while flying."""
        index = self.ticks
        if not self.flying or index == len(self._excitation):
            return self._controller.step(inputs)
        north, east, down = self._excitation[index].tolist()
        d = (north, east, down)
        output = self._controller.step(replace(inputs, excitation=(d, ZERO) if self._channel == 0 else (ZERO, d)))
        self.demand[index] = (output.position if self._channel == 0 else output.attitude).demand
        self.ticks += 1
        return output

    def reset(self, inputs: ControlInputs) -> None:
        """Reset the controller."""
        self._controller.reset(inputs)


def measure(config: FlightConfig, channel: int, band: Band | None = None) -> list[Response]:
    """Fly and measure the three loops of a channel (0 position, 1 attitude).

    Raises
    ------
    LoopMeasurementError
        If the vehicle crashes, or the flight is too short.
    """
    band = band or BANDS[channel]
    period_s = config.onboard.period_ns * 1e-9
    ticks = round(band.period_s / period_s)
    harmonics = [_harmonics(band, axis) for axis in range(3)]
    excitation = np.tile(_multisine(band, harmonics, ticks), (band.periods + 1, 1))
    lockstep, onboard, _, _ = build(config)
    excited = Excited(onboard.controller, channel, excitation)
    onboard.controller = excited
    for _ in range(round(config.duration_s / period_s)):
        result = lockstep.step()
        excited.flying = int(result.onboard.tick[0]) == FlightMode.FLYING
        if excited.ticks == len(excitation) or lockstep.crash_reason:
            break
    if excited.ticks < len(excitation):
        reason = lockstep.crash_reason or f"the flight of {config.duration_s:g} s is too short"
        raise LoopMeasurementError(f"{config.controller}, {('position', 'attitude')[channel]} channel: {reason}")
    responses = []
    for axis, multiples in enumerate(harmonics):
        u = excited.demand[ticks:, axis].reshape(band.periods, ticks).mean(axis=0)
        U, D = np.fft.rfft(u)[multiples], np.fft.rfft(excitation[:ticks, axis])[multiples]
        omega = 2.0 * np.pi * multiples / band.period_s
        responses.append(Response(LOOPS[channel][axis], omega, -U / (U + D)))
    return responses


def _harmonics(band: Band, axis: int) -> Array:
    """Multiples of 1 / period_s, spaced evenly in log frequency, different ones for each axis."""
    low, high = band.low_hz * band.period_s, band.high_hz * band.period_s
    wanted = np.exp(np.linspace(np.log(low), np.log(high), 3 * band.tones))
    taken: list[int] = []
    for value in wanted:
        number = max(round(float(value)), taken[-1] + 1 if taken else 1)
        taken.append(number)
    return np.array(taken[axis::3])


def _multisine(band: Band, harmonics: list[Array], ticks: int) -> Array:
    """[ticks, 3]: one period; phases of Schroeder (1970), which keep the peaks low."""
    time = np.arange(ticks) / ticks
    columns = []
    for multiples in harmonics:
        n = len(multiples)
        phases = -np.pi * np.arange(n) * (np.arange(n) - 1) / n
        waves = np.cos(2.0 * np.pi * np.outer(time, multiples) + phases)
        columns.append(band.amplitude * waves.sum(axis=1))
    return np.stack(columns, axis=1)
