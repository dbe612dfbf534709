"""Refuses to start where another distribution's package stands in the place of one of ours."""

from importlib.machinery import PathFinder
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Final

PACKAGES: Final = {
    "configs": "loader.py",
    "experiments": "flights",
    "flight_log": "writer.py",
    "offboard": "core.py",
    "onboard": "core.py",
    "mambo": "vehicles.py",
    "protocol": "messages.py",
    "runtime": "sockets.py",
    "sim_vehicle": "vehicle.py",
}
"""Our packages, each with a file or folder that only ours has."""


def refuse_shadowed_packages() -> None:
    """Check that every package name of ours leads to our own code.

    Raises
    ------
    ImportError
        Naming the package, where the other one lies, and the distribution that it belongs to.
    """
    root = Path(__file__).resolve().parent.parent
    for name, mark in PACKAGES.items():
        spec = PathFinder.find_spec(name)
        found = Path(spec.origin).resolve().parent if spec is not None and spec.origin else None
        if found != root / name or not (root / name / mark).exists():
            others = [one for one in packages_distributions().get(name, ()) if one != "async-dmrac"]
            owner = f"of the distribution {' and '.join(others)}" if others else "of no installed distribution"
            raise ImportError(
                f"async-dmrac needs its own package {name!r}, but Python finds another one at {found or 'no place'}, "
                f"{owner}. Install async-dmrac in an environment of its own, or remove the other one."
            )
