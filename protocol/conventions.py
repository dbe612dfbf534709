"""Constants that every package shares. docs/conventions.md explains frames, rotations and motor order."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GRAVITY: Final = 9.80665
"""m/s^2, along north-east-down's down axis."""
NEVER_NS: Final = -(10**18)
"""Time of an event that has not happened yet: its age is large for every clock."""
