"""Registers the environments. Gymnasium calls `register` by itself where async-dmrac is installed with its extra."""

from typing import Final

ENVIRONMENT: Final = "async_dmrac/Mambo-v0"
_MODULE: Final = "async_dmrac.environments.mambo"


def register() -> None:
    """Register the environments with Gymnasium, once. Raises ImportError if gymnasium is not installed."""
    import gymnasium

    if ENVIRONMENT not in gymnasium.registry:
        gymnasium.register(
            ENVIRONMENT, entry_point=f"{_MODULE}:MamboEnv", vector_entry_point=f"{_MODULE}:MamboVectorEnv"
        )


def register_plugin() -> None:
    """Register for Gymnasium's entry point, which puts the namespace before the name itself."""
    import gymnasium

    name = ENVIRONMENT.rpartition("/")[2]
    gymnasium.register(name, entry_point=f"{_MODULE}:MamboEnv", vector_entry_point=f"{_MODULE}:MamboVectorEnv")
