"""Fly, learn and look at flights from Python: the one import name that a user needs.

>>> import async_dmrac
>>> flight = async_dmrac.fly("hover", controller="pid", seed=3)         # doctest: +SKIP
>>> flight["onboard/tick"]["position_n"]                                # doctest: +SKIP
"""

from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from async_dmrac.shadowing import refuse_shadowed_packages

refuse_shadowed_packages()

if TYPE_CHECKING:
    from async_dmrac.interface import fly, load_flight

__all__ = ["__version__", "fly", "load_flight"]
__version__ = version("async-dmrac")


def __getattr__(name: str) -> Any:
    """Import the interface at its first use: `dmrac onboard` starts without it."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from async_dmrac import interface

    return getattr(interface, name)
