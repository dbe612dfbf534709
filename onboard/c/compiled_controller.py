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
            self._matrix(law.adaptive.last_layer) if self._core.augmentation_has_features(law) else None
            for law in self._cascade.augmentations
        )
        return position, attitude

    def start_from(self, last_layers: tuple[Array | None, Array | None]) -> None:
        """Start with W of an earlier flight with the same features. Raises ValueError if the shapes differ."""
        for law, W in zip(self._cascade.augmentations, last_layers, strict=True):
            if W is None or not self._core.augmentation_has_features(law):
                continue
            layer = law.adaptive.last_layer
            if W.shape != (layer.feature_count, 3):
                raise ValueError(f"last layer of shape {W.shape}, this controller's is {(layer.feature_count, 3)}")
            values = np.ascontiguousarray(W, dtype=view(layer.W).dtype).reshape(-1)
            self._core.last_layer_replace(layer, values, values, layer.feature_count)

    @staticmethod
    def _matrix(layer: Any) -> Array:
        W: Array = view(layer.W)[: 3 * layer.feature_count].reshape(-1, 3).astype(np.float64)
        return W
