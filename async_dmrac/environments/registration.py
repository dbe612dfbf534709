"""Registers the environments with Gymnasium, which does not look for them by itself since version 1.0."""

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
