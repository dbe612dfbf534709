"""The margins that a controller must have, and how far its predicted loops are from them."""

from typing import Annotated, Final

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from experiments.flights.scenario import FlightConfig
from experiments.margins.linear import predicted_loop
from experiments.margins.stability import Margins, margins

OMEGA: Final = 2.0 * np.pi * np.geomspace(0.05, 40.0, 300)
"""rad/s: from far below the position loop to far above the attitude loop."""
LOOPS: Final = ((0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2))
"""Channel and axis."""

Positive = Annotated[float, Field(gt=0)]


class MarginRequirement(ConfigRecord):
    """Least margins of every loop."""

    gain_margin_db: Positive
    phase_margin_deg: Positive
    delay_margin_ms: Positive

    def shortfall(self, config: FlightConfig) -> float:
        """The largest share by which a predicted margin of a loop is below its least; 0 if none is.

        Raises
        ------
        ValueError
            If the controller is not a cascade.
        """
        return max(
            self.shortfall_of(margins(OMEGA, predicted_loop(config, channel, axis, OMEGA))) for channel, axis in LOOPS
        )

    def shortfall_of(self, found: Margins) -> float:
        """The same for one loop."""
        pairs = (
            (found.gain_margin_db, self.gain_margin_db),
            (found.phase_margin_deg, self.phase_margin_deg),
            (found.delay_margin_ms, self.delay_margin_ms),
        )
        return max(max(0.0, float(1.0 - has / needs)) for has, needs in pairs)
