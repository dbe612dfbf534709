"""The interface of a controller, and how a configuration entry names its class.

A controller of your own is a class with a nested pydantic `Settings` record and the methods of `Controller`. Name it in
a controller file, `configs/controllers/<name>.yaml` or any path, and it flies like the built-in ones:

    class: my_package.my_module:MyController
    settings: {gain: 2.0}

A class in any file is named `class: path/to/my_file.py:MyController` (configs.user_class).
"""

from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from pydantic import BaseModel, Field

from configs.loader import ConfigError, ConfigRecord, fill
from configs.named_class import named_class
from configs.user_class import PATTERN
from onboard.control.airframe import AirframeConfig
from onboard.control.records import ControlInputs, ControlOutput
from protocol.feature_config import FeaturesConfig
from protocol.feature_set import FeatureSet

if TYPE_CHECKING:
    from onboard.control.guard import Fall


class Controller(Protocol):
    """Computes collective thrust and body torque from state and target, once per tick.

    The class is called as `Class(settings, airframe, seed)`; it must not touch clocks, files or global random state.
    """

    Settings: type[ConfigRecord]

    def step(self, inputs: ControlInputs) -> ControlOutput:
        """The command for this tick. The output may be the same object every time."""

    def reset(self, inputs: ControlInputs) -> None:
        """Start over from the present state. Called in every tick on the ground."""


@runtime_checkable
class LearningController(Protocol):
    """A controller that also accepts features trained off board."""

    @property
    def accepts_features(self) -> bool:
        """Whether it can use them with its settings; if not, offboard only relays poses."""

    def offer_features(self, features: FeatureSet) -> str:
        """Swap to the new features, all channels or none; returns "" or the refusal (protocol.messages.REFUSALS)."""


@runtime_checkable
class PreparingController(LearningController, Protocol):
    """A learning controller that prepares a swap over many ticks."""

    def begin_features(self, features: FeatureSet) -> None:
        """Start to prepare a version, in place of the one that is being prepared."""

    def advance_features(self) -> str | None:
        """One part, once a tick: None while it goes on; "" if the version is in use now, or the refusal."""

    def cancel_features(self) -> None:
        """Forget the version that is being prepared, if any."""


@runtime_checkable
class GuardedController(Protocol):
    """A controller that may take a version back (onboard.control.guard)."""

    def take_falls(self) -> "list[Fall]":
        """What happened since the last call."""


class ControllerConfig(ConfigRecord):
    """A controller: the import path of its class, and the settings of that class."""

    class_path: str = Field(alias="class", pattern=PATTERN, description="module:Class or file.py:Class")
    settings: dict[str, Any]

    def build(
        self, airframe: AirframeConfig, features: FeaturesConfig, seed: int, source: str = "controller"
    ) -> Controller:
        """Build the controller. A field `features` of its `Settings` gets the flight's features section.

        Raises
        ------
        ConfigError
            If the class cannot be found or its settings do not fit; names `source` and the path.
        """
        settings = self.filled_settings(features, source)
        controller: Controller = self.controller_class(source)(settings, airframe, seed)
        return controller

    def filled_settings(self, features: FeaturesConfig, source: str = "controller") -> BaseModel:
        """Return the settings as the class's record, with its defaults. Raises ConfigError as `build` does."""
        record = self.controller_class(source).Settings
        given = {"features": features} if "features" in record.model_fields else {}
        settings: BaseModel = fill(record, self.settings | given, source, "controller.settings.")
        return settings

    def completed(self, features: FeaturesConfig, source: str = "controller") -> "ControllerConfig":
        """Return the same controller with all settings written out. Raises ConfigError as `build` does."""
        settings = self.filled_settings(features, source).model_dump(by_alias=True, exclude={"features"})
        return self.model_copy(update={"settings": settings})

    def controller_class(self, source: str = "controller") -> Any:
        """The class named by `class_path`. Raises ConfigError."""
        try:
            controller_class = named_class(self.class_path, "onboard.controller.class")
        except ImportError as error:
            raise ConfigError(f"{source}: controller.class: {self.class_path!r} cannot be loaded: {error}") from None
        wanted = ("Settings", "step", "reset")
        missing = [name for name in wanted if not hasattr(controller_class, name)]
        if missing:
            raise ConfigError(f"{source}: controller.class: {self.class_path!r} has no {missing[0]}")
        return controller_class
