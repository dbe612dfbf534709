"""The optional parts of the installation: which modules each needs, and which of them are missing here."""

import importlib.util
from typing import Final

from runtime.errors import PlainError

EXTRAS: Final[dict[str, tuple[str, ...]]] = {
    "sim": ("numba",),
    "mujoco": ("mujoco",),
    "rotorpy": ("rotorpy",),
    "offboard": ("torch",),
    "experiments": ("matplotlib", "optuna", "pyarrow", "sklearn", "threadpoolctl"),
    "cluster": ("distributed",),
    "viz": ("rerun",),
    "export": ("foxglove", "pyarrow", "rosbags", "tensorboard"),
    "completion": ("shtab",),
    "gym": ("gymnasium", "numba"),
    "core": ("ziglang",),
}
"""The modules of each extra of pyproject.toml that this program imports itself."""


class MissingExtraError(PlainError, ImportError):
    """A part of the installation is missing. The message names the modules and the command that installs them."""


def missing_modules(extra: str) -> list[str]:
    """The modules of an extra that cannot be imported here."""
    return [module for module in EXTRAS[extra] if not _installed(module)]


def require_modules(*modules: str, purpose: str = "") -> None:
    """Check that modules are installed; imports none of them. Those of EXTRAS are named with their extra.

    Parameters
    ----------
    purpose: what needs them, for the message, such as "--tensorboard"; "" if it is the whole command.

    Raises
    ------
    MissingExtraError
        If one is missing.
    """
    missing = [module for module in modules if not _installed(module)]
    if missing:
        extra_of = {module: extra for extra, own in reversed(EXTRAS.items()) for module in own}
        extras = dict.fromkeys(extra_of[module] for module in missing if module in extra_of)
        words = [f"'async-dmrac[{','.join(extras)}]'"] if extras else []
        words += [module for module in missing if module not in extra_of]
        before = f"{purpose}: " if purpose else ""
        raise MissingExtraError(
            f"{before}not installed: {', '.join(missing)}. Install with: pip install {' '.join(words)}"
        )


def _installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # the package that it is in
        return False
