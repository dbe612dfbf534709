"""Fly, learn and look at flights from Python: the one import name that a user needs (docs/python.md).

>>> import async_dmrac
>>> flight = async_dmrac.fly("hover", controller="pid", seed=3)         # doctest: +SKIP
>>> flight["onboard/tick"]["position_n"]                                # doctest: +SKIP

Every name is imported at its first use, so that `import async_dmrac` stays light.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Final

from async_dmrac.shadowing import refuse_shadowed_packages

refuse_shadowed_packages()

if TYPE_CHECKING:
    from pydantic import Field

    from async_dmrac.interface import campaign, campaign_file, configure, fly, load_flight
    from async_dmrac.learner import Learner
    from async_dmrac.record import CampaignResult, Flight, Table, controllers, scenarios
    from configs.loader import ConfigError, ConfigRecord
    from flight_log.reader import Event, FlightError
    from onboard.control.interface import Controller, LearningController
    from onboard.control.records import ControlInputs, ControlOutput
    from sim_vehicle.world.interface import Condition, Disturbance

_MODULES: Final = {
    "async_dmrac.interface": ("campaign", "campaign_file", "configure", "fly", "load_flight"),
    "async_dmrac.learner": ("Learner",),
    "async_dmrac.record": ("CampaignResult", "Flight", "Table", "controllers", "scenarios"),
    "configs.loader": ("ConfigError", "ConfigRecord"),
    "flight_log.reader": ("Event", "FlightError"),
    "onboard.control.interface": ("Controller", "LearningController"),
    "onboard.control.records": ("ControlInputs", "ControlOutput"),
    "pydantic": ("Field",),
    "sim_vehicle.world.interface": ("Condition", "Disturbance"),
}
_OWNERS: Final = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "CampaignResult",
    "Condition",
    "ConfigError",
    "ConfigRecord",
    "ControlInputs",
    "ControlOutput",
    "Controller",
    "Disturbance",
    "Event",
    "Field",
    "Flight",
    "FlightError",
    "Learner",
    "LearningController",
    "Table",
    "__version__",
    "campaign",
    "campaign_file",
    "configure",
    "controllers",
    "fly",
    "load_flight",
    "scenarios",
]
__version__ = version("async-dmrac")


def __getattr__(name: str) -> Any:
    """Import a name at its first use: `dmrac onboard` starts without the interface."""
    if name not in _OWNERS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_OWNERS[name]), name)


def __dir__() -> list[str]:
    """The public names, for completion."""
    return sorted(__all__)
