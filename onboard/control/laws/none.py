"""No adaptation: nu_ad = 0."""

from typing import Literal

import numpy as np

from configs.loader import ConfigRecord
from onboard.control.laws.law import ChannelState
from onboard.control.records import ChannelTelemetry
from protocol.conventions import Array


class NoneConfig(ConfigRecord):
    """No law: proportional-derivative control with feed-forward."""

    kind: Literal["none"]


class NoAugmentation:
    """nu_ad = 0."""

    def __init__(self, config: NoneConfig) -> None:
        self._zero: Array = np.zeros(3)

    def step(self, channel: ChannelState, telemetry: ChannelTelemetry) -> Array:
        """Returns zero."""
        return self._zero

    def reset(self) -> None:
        """Nothing to reset."""
