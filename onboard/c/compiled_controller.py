"""The controller inside the C core, for what a flight starts from and has learnt."""

from typing import Any

import numpy as np

from onboard.c.feature_arrays import put_feature_set, view
from protocol.conventions import Array
from protocol.feature_set import FeatureSet
from protocol.messages import REFUSALS


class CompiledController:
    """A Cascade of the C core; it is stepped by the core."""

    def __init__(self, core: Any, cascade: Any) -> None:
        """core: the library. cascade: a structure that belongs to the caller."""
        self._core, self._cascade = core, cascade
        self._features = core.FeatureSet()

    @property
    def accepts_features(self) -> bool:
        """Whether a channel has network features."""
        return bool(self._core.cascade_accepts_features(self._cascade))

    def offer_features(self, features: FeatureSet) -> str:
        """Swap the features of both channels, or refuse (onboard.control.interface.LearningController)."""
        put_feature_set(self._features, features)
        refusal: str = REFUSALS[self._core.cascade_offer_features(self._cascade, self._features)]
        return refusal

    def last_layers(self) -> tuple[Array | None, Array | None]:
        """W [k, 3] of the position and the attitude channel; None for a channel without."""
        position, attitude = (
            self._last_layer(law.adaptive) if self._core.augmentation_has_features(law) else None
            for law in self._cascade.augmentations
        )
        return position, attitude

    def start_from(self, last_layers: tuple[Array | None, Array | None]) -> None:
        """Start with W of an earlier flight with the same features. Raises ValueError if the shapes differ."""
        for law, W in zip(self._cascade.augmentations, last_layers, strict=True):
            if W is None or not self._core.augmentation_has_features(law):
                continue
            present = self._last_layer(law.adaptive)
            if W.shape != present.shape:
                raise ValueError(f"last layer of shape {W.shape}, this controller's is {present.shape}")
            self._core.adaptive_start_from(law.adaptive, np.ascontiguousarray(W, dtype=_real(law.adaptive)).reshape(-1))

    def _last_layer(self, adaptive: Any) -> Array:
        """W [k, 3] of an Adaptive."""
        W = np.empty((adaptive.features.feature_count, 3), dtype=_real(adaptive))
        self._core.adaptive_W(adaptive, W)
        return W.astype(np.float64)


def _real(adaptive: Any) -> Any:
    """numpy's type of the numbers in C."""
    return view(adaptive.Delta_hat).dtype
