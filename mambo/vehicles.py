"""Names of the drone's library in `dmrac fly --vehicle`."""

from typing import Final, Literal

TargetName = Literal["arm", "native"]
"""The drone's processor under qemu-arm, and this machine's own."""
VEHICLES: Final[dict[str, TargetName]] = {"mambo-qemu": "arm", "mambo-native": "native"}
RADIO: Final = "bluetooth"
"""In configs/radio: the drone's."""
