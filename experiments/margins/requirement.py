"""The margins that a controller must have, and how far its predicted loops are from them."""

from functools import lru_cache
from typing import Annotated, Final

import numpy as np
from pydantic import Field

from configs.loader import ConfigError, ConfigRecord, fill, set_path
from configs.vehicle import read_vehicle
from experiments.flights.scenario import FlightConfig
from experiments.margins.linear import LinearModel, PredictedLoop
from experiments.margins.stability import Margins, margins, unstable_poles
from experiments.margins.steepest_map import steepest_map_margins
from sim_vehicle.config import SimVehicleConfig

OMEGA: Final = 2.0 * np.pi * np.geomspace(0.05, 40.0, 300)
"""rad/s: from far below the position loop to far above the attitude loop. Margins are found here."""
FROM_FAR_BELOW: Final = np.concatenate([2.0 * np.pi * np.geomspace(0.0005, 0.05, 60, endpoint=False), OMEGA])
"""rad/s: from far below the slowest rate of a law as well, to count unstable poles."""
BAND: Final = slice(len(FROM_FAR_BELOW) - len(OMEGA), None)
"""Of FROM_FAR_BELOW, OMEGA."""
LOOPS: Final = ((0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2))
"""Channel and axis."""
UNSTABLE_MAX: Final = 3.0
"""Most by which the shortfall of an unstable loop is above 1."""

Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]


class MarginRequirement(ConfigRecord):
    """Least margins of every loop. The gain margin counts upwards and downwards."""

    gain_margin_db: Positive
    phase_margin_deg: Positive
    delay_margin_ms: Positive

    def shortfall(self, config: FlightConfig) -> float:
        """The largest share by which a predicted margin of a loop is below its least.

        0 if none is; above 1 if the closed loop is unstable.

        Raises
        ------
        ValueError
            If the controller is not a cascade.
        """
        model = LinearModel(config, FROM_FAR_BELOW)
        return max(self.shortfall_of(model.loop(channel, axis)) for channel, axis in LOOPS)

    def shortfall_of(self, loop: PredictedLoop) -> float:
        """The same for one loop, at the frequencies FROM_FAR_BELOW.

        The margins of an unstable loop are how far it is from stability; with that, the shortfall grows above 1.
        """
        shares = self._shares(margins(OMEGA, loop.L[BAND]))
        if unstable_poles(loop.characteristic):
            return 1.0 + min(*shares[:2], UNSTABLE_MAX)
        return _missing(shares)

    def shortfall_with_the_steepest_map(self, config: FlightConfig) -> float:
        """The same of the position loop with the steepest map that the guard accepts; 0 without such a map."""
        found = steepest_map_margins(config, OMEGA)
        return max((_missing(self._shares(one.margins)) for one in found), default=0.0)

    def _shares(self, found: Margins) -> list[float]:
        """Of what is needed: gain, phase and delay margin."""
        pairs = (
            (found.gain_margin_db, self.gain_margin_db),
            (found.phase_margin_deg, self.phase_margin_deg),
            (found.delay_margin_ms, self.delay_margin_ms),
        )
        return [float(has / needs) for has, needs in pairs]


def _missing(shares: list[float]) -> float:
    """What the smallest of the shares is short of 1."""
    return max(0.0, 1.0 - min(shares))


class Corner(ConfigRecord):
    """A vehicle at the ends of the ranges that vehicles are drawn from, and the least margins there."""

    name: str
    at: dict[str, Share] = Field(min_length=1)
    """Values by their path in the vehicle, each at this share of its tuning range (configs/vehicles): 0 low, 1 high."""
    margins: MarginRequirement

    def shortfall(self, config: FlightConfig, vehicle: str) -> float:
        """As MarginRequirement.shortfall, with this vehicle in place of the flight's. Onboard assumes the same.

        vehicle: name of the description that has the ranges.
        """
        changed = _corner_vehicle(vehicle, tuple(sorted(self.at.items())), self.name)
        return self.margins.shortfall(config.model_copy(update={"vehicle": changed}))


@lru_cache(maxsize=64)
def _corner_vehicle(name: str, at: tuple[tuple[str, float], ...], corner: str) -> SimVehicleConfig:
    description = read_vehicle(name)
    tree = description.simulated
    for path, share in at:
        try:
            value = description.drawn(path, share, "tuning")
        except ConfigError as error:
            raise ConfigError(f"corners: {corner}: at: {error}") from None
        tree = set_path(tree, f"{path}={value}")
    return fill(SimVehicleConfig, tree, f"corners: {corner}")
