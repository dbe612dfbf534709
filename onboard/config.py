"""All of onboard's configuration: one record per block, each defined beside its block."""

from typing import Annotated, Final, Self

from pydantic import Field, model_validator

from configs.loader import ConfigRecord
from configs.realtime import RealtimeConfig
from onboard.control.airframe import AirframeConfig
from onboard.control.interface import ControllerConfig
from onboard.control.thrust_scale import ThrustScaleConfig
from onboard.estimation.config import EstimatorConfig
from onboard.estimation.pose_health import PoseHealthConfig
from onboard.flight.guidance import GuidanceConfig
from onboard.flight.supervisor import SupervisorConfig
from onboard.links.ground import GroundLinkConfig
from onboard.links.vehicle import VehicleLinkConfig
from onboard.sampling.sampler import SamplerConfig
from protocol.endpoint import CHALLENGE_PERIOD_NS
from protocol.feature_config import FeaturesConfig

STATUS_BYTES: Final = 154
"""The longest status, UDP and IP included."""
SYNC_REQUEST_BYTES: Final = 92
SYNC_REPLY_BYTES: Final = 110


class OnboardConfig(ConfigRecord):
    """All of the onboard side."""

    vehicle_id: Annotated[int, Field(ge=0, lt=2**16)] = 1
    seed: Annotated[int, Field(ge=0, lt=2**31, description="of the random start features")] = 1
    period_ns: Annotated[int, Field(ge=1_000_000, le=50_000_000, description="ns, one tick")] = 5_000_000
    status_period_s: Annotated[float, Field(ge=0.02, le=5, description="s between two Status messages")] = 0.1
    time_sync_period_s: Annotated[float, Field(ge=0.1, le=60, description="s between two requests")] = 1.0
    pose_wait_s: Annotated[float, Field(ge=0, le=600, description="s")] | None = None
    """Arming waits no longer for a first pose; null: until it comes. For flights without motion capture."""
    airframe: AirframeConfig
    thrust_scale: ThrustScaleConfig = ThrustScaleConfig()
    estimator: EstimatorConfig = EstimatorConfig()
    supervisor: SupervisorConfig = SupervisorConfig()
    vehicle_link: VehicleLinkConfig = VehicleLinkConfig()
    ground_link: GroundLinkConfig = GroundLinkConfig()
    pose_health: PoseHealthConfig = PoseHealthConfig()
    guidance: GuidanceConfig
    controller: ControllerConfig
    features: FeaturesConfig
    samples: SamplerConfig = SamplerConfig()
    realtime: RealtimeConfig = RealtimeConfig()

    @model_validator(mode="after")
    def _budget_holds_the_talk(self) -> Self:
        """Status and time sync go whatever the samples need: they alone must keep to the budget."""
        talk = STATUS_BYTES / self.status_period_s
        talk += SYNC_REQUEST_BYTES / min(self.status_period_s, self.time_sync_period_s)
        talk += SYNC_REPLY_BYTES * 1e9 / CHALLENGE_PERIOD_NS
        if talk > self.samples.budget_bytes_s:
            raise ValueError(
                f"samples.budget_bytes_s {self.samples.budget_bytes_s:g}: status_period_s {self.status_period_s:g} and "
                f"time_sync_period_s {self.time_sync_period_s:g} may take {talk:.0f} B/s; "
                "allowed is no less than that, or make the periods longer"
            )
        return self
