"""Finds the class of a disturbance by its `kind`: a file of sim_vehicle/disturbances, module:Class or file.py:Class."""

import pkgutil
from collections.abc import Iterable, Mapping
from functools import cache
from inspect import signature
from typing import Annotated, Any, Final

from pydantic import BeforeValidator, SerializeAsAny, ValidationError
from pydantic_core import PydanticCustomError

import sim_vehicle.disturbances
from configs.named_class import named_class
from configs.user_class import EXPECTED, name_of
from sim_vehicle.world.interface import Disturbance

_BUILT_IN: Final = "sim_vehicle.disturbances."
_OWN: Final = "or module:Class or file.py:Class for one of your own"


def kind_of(one: type[Disturbance]) -> str:
    """The `kind` by which `disturbance_class` finds this class."""
    name = one.__module__.removeprefix(_BUILT_IN)
    return name if name != one.__module__ else name_of(one)


@cache
def kinds() -> tuple[str, ...]:
    """The built-in kinds, sorted."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(sim_vehicle.disturbances.__path__)))


def disturbance_class(kind: str) -> type[Disturbance]:
    """The class of a kind. Raises ValueError if there is none, or it is no complete disturbance."""
    own = ":" in kind
    if not own and kind not in kinds():
        raise ValueError(f"unknown kind; allowed are {', '.join(kinds())}, {_OWN}")
    camel_case = kind.title().replace("_", "")
    try:
        found: Any = named_class(kind if own else f"{_BUILT_IN}{kind}:{camel_case}", "vehicle.disturbances: kind")
    except (ImportError, ValueError) as error:
        raise ValueError(f"cannot be loaded: {error}; {EXPECTED}") from None
    if not (isinstance(found, type) and issubclass(found, Disturbance)):
        raise ValueError("expected a subclass of sim_vehicle.world.interface.Disturbance")
    if not found.acts() and found.change is Disturbance.change:
        raise ValueError("has neither of the methods act and change; at least one is needed")
    if len(signature(found.act).parameters) != len(signature(Disturbance.act).parameters):
        raise ValueError(
            f"its act is act{signature(found.act)}, expected act({', '.join(signature(Disturbance.act).parameters)})"
        )
    return found


@cache
def _built_in_classes() -> tuple[type[Disturbance], ...]:
    """The classes of `kinds`; finding and checking them takes longer than starting a vehicle again."""
    return tuple(map(disturbance_class, kinds()))


def acting_classes(disturbances: Iterable[Disturbance] = ()) -> tuple[type[Disturbance], ...]:
    """The classes with an `act`, in the order of their numbers: the built-in ones, then others of `disturbances`."""
    classes = dict.fromkeys([*_built_in_classes(), *(one.__class__ for one in disturbances)])
    return tuple(one for one in classes if one.acts())


def _read(value: Any) -> Any:
    """The record of a plain tree, checked by the class of its kind."""
    if not isinstance(value, Mapping):
        return value
    kind = value.get("kind")
    if not isinstance(kind, str):
        raise _fault("kind", kind, f"missing; allowed are {', '.join(kinds())}, {_OWN}")
    try:
        found = disturbance_class(kind)
    except ValueError as error:
        raise _fault("kind", kind, str(error)) from None
    for key in value:
        if key not in found.model_fields:
            raise _fault(key, value[key], f"unknown key; {kind} allows {', '.join(sorted(found.model_fields))}")
    return found.model_validate(value)


def _fault(key: str, value: Any, message: str) -> ValidationError:
    error = PydanticCustomError("disturbance", "{message}", {"message": message})
    return ValidationError.from_exception_data("disturbance", [{"type": error, "loc": (key,), "input": value}])


AnyDisturbance = Annotated[SerializeAsAny[Disturbance], BeforeValidator(_read)]
"""A disturbance of any kind, as a field of a configuration record."""
