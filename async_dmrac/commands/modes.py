"""`dmrac modes`: the flight modes by number and name, and the file by which MAVProxy shows the names."""

import argparse
import json

from pymavlink.dialects.v20 import common as mavlink

from async_dmrac.commands.output import add_json_option, print_json
from onboard.links.ground import MODE_NAMES

DESCRIPTION = "Print the flight modes: the number in HEARTBEAT's custom mode, and the name."
EXAMPLES = """examples:
  dmrac modes
  mkdir -p ~/.pymavlink && dmrac modes --mavproxy > ~/.pymavlink/custom_mode_map.json

The file gives the names to MAVProxy and to all programs that use pymavlink, for every quadrotor: remove it before you
fly another autopilot. QGroundControl asks the vehicle for the names (AVAILABLE_MODES) and needs no file.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac modes`."""
    parser.add_argument("--mavproxy", action="store_true", help="print pymavlink's custom_mode_map.json")
    add_json_option(parser, "the modes")


def run(arguments: argparse.Namespace) -> int:
    """Print the modes; returns 0."""
    if arguments.mavproxy:
        modes = {str(number): name for number, name in MODE_NAMES.items()}
        print(json.dumps({str(mavlink.MAV_TYPE_QUADROTOR): modes}, indent=1))
    elif arguments.json:
        print_json(MODE_NAMES)
    else:
        for number, name in MODE_NAMES.items():
            print(f"{number:>2}  {name}")
    return 0
