"""Which classes a configuration may name (`configs.user_class` finds them). To import one is to run its code.

A configuration that somebody writes or chooses may name any class. A recorded one may be a stranger's: while
`shipped_classes_only` holds, only the controllers of configs/controllers and the built-in disturbances can be named.
"""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache
from typing import Any

from configs.loader import CONFIG_DIRECTORY, ConfigError, read_tree
from configs.user_class import find_class

_holds = 0
"""How many `shipped_classes_only` are open, in all threads: the safe side."""


class UntrustedClassError(ConfigError):
    """A record names a class that this project does not ship."""


@contextmanager
def shipped_classes_only() -> Iterator[None]:
    """Import no class but those of this project, for a configuration of unknown origin."""
    global _holds
    _holds += 1
    try:
        yield
    finally:
        _holds -= 1


def classes_for(trust: bool) -> AbstractContextManager[None]:
    """Where a record is read: with `trust` any class may be imported, without it those of this project."""
    return nullcontext() if trust else shipped_classes_only()


def named_class(path: str, key: str) -> Any:
    """The class of a path, as of `configs.user_class.find_class`.

    Parameters
    ----------
    key: of the configuration, for the message.

    Raises
    ------
    UntrustedClassError
        If the class is none of this project's while `shipped_classes_only` holds.
    ImportError
        If there is no such class.
    """
    if _holds and path not in shipped_controllers() and not _is_disturbance(path):
        raise UntrustedClassError(
            f"{key}: {path!r} is not part of this project, and to import it runs its code; "
            "if you know and trust it, add --trust"
        )
    return find_class(path)


@cache
def shipped_controllers() -> frozenset[str]:
    """The classes that the files of configs/controllers name."""
    files = sorted((CONFIG_DIRECTORY / "controllers").glob("*.yaml"))
    return frozenset(str(read_tree(file).get("class")) for file in files)


def _is_disturbance(path: str) -> bool:
    """Whether the class is in a file of sim_vehicle/disturbances."""
    module, _, _ = path.rpartition(":")
    package, _, file = module.rpartition(".")
    folder = CONFIG_DIRECTORY.parent / "sim_vehicle" / "disturbances"
    return package == "sim_vehicle.disturbances" and file.isidentifier() and (folder / f"{file}.py").is_file()
