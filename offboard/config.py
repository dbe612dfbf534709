"""What the offboard side needs to know, as frozen records that configs/offboard.yaml fills."""

from typing import Literal, Self

from pydantic import Field, model_validator

from configs.loader import ConfigRecord
from protocol.config import TransferConfig
from protocol.feature_config import FeaturesConfig
from protocol.signals import input_indices


class LabelConfig(ConfigRecord):
    """What the networks are asked to reproduce (control.md, section 5)."""

    kind: Literal["residual", "mrgen"] = Field(
        description="residual: the measured uncertainty; mrgen: nu_ad as it flew (the paper)"
    )
    position_window_s: float = Field(gt=0.0, le=2.0, description="s, length of the smoothing window")
    attitude_window_s: float = Field(gt=0.0, le=2.0, description="s, length of the smoothing window")
    order: int = Field(ge=0, le=4, description="degree of the smoothing polynomial")
    reorder_s: float = Field(ge=0.0, le=2.0, description="s, how long a missing sample is waited for")
    minimum_height_m: float = Field(ge=0.0, description="m above the floor; samples from below are not used")
    position_limit_m_s2: float = Field(gt=0.0, description="m/s^2, larger labels are not believed")
    attitude_limit_rad_s2: float = Field(gt=0.0, description="rad/s^2, larger labels are not believed")


class BufferConfig(ConfigRecord):
    """Which samples are kept (control.md, section 6)."""

    capacity: int = Field(ge=8, le=4000, description="samples, p_max")
    admission: Literal["kernel", "history"] = Field(description="kernel: GP novelty; history: Chowdhary and Johnson")
    deletion: Literal["svd", "fifo"] = Field(description="what a full buffer gives up")
    novelty_inputs: tuple[str, ...] = Field(min_length=1, description="signals the kernel compares")
    kernel_width: float = Field(gt=0.0, description="width of the Gaussian kernel, in scaled inputs")
    kernel_tolerance: float = Field(gt=0.0, lt=1.0, description="zeta_tol, smallest gamma that is new")
    history_tolerance: float = Field(gt=0.0, description="smallest norm(dPhi)^2 / norm(Phi) that is new")
    refresh_age_s: float = Field(gt=0.0, description="s; an older entry is replaced by a sample it resembles")
    newest: int = Field(ge=16, le=4000, description="samples, store of the newest, new or not")
    newest_scale: float = Field(gt=0.0, description="samples of age over which the draw of the newest fades by 1/e")
    newest_fraction: float = Field(ge=0.0, le=1.0, description="share of each mini-batch drawn from the newest")
    block_s: float = Field(gt=0.0, le=10.0, description="s, length of a block that goes to one split as a whole")
    blocks_per_group: int = Field(ge=3, description="one block in each group of so many is held out for validation")
    release_s: float = Field(gt=0.0, description="s after which validation samples are trained on, newer ones held out")
    groups_per_test: int = Field(ge=1, description="one block in every so many groups is held out for testing")

    @model_validator(mode="after")
    def _inputs_known(self) -> Self:
        input_indices(self.novelty_inputs)
        return self


class TrainerConfig(ConfigRecord):
    """How the networks are trained (control.md, section 7)."""

    optimiser: Literal["adam", "sgd"]
    learning_rate: float = Field(gt=0.0)
    momentum: float = Field(ge=0.0, lt=1.0, description="of sgd")
    weight_decay: float = Field(ge=0.0, description="l2 on all weights")
    batch_size: int = Field(ge=1, le=4096, description="M, samples per mini-batch")
    batches: int = Field(ge=1, le=10000, description="mini-batches per round")
    epochs: int = Field(ge=1, le=100, description="parts of a round after each of which the losses are recorded")
    projection_every: int = Field(ge=1, description="mini-batches between projections of the spectral norms")
    period_s: float = Field(ge=0.0, description="s, least time between starts of rounds")
    minimum_samples: int = Field(ge=8, description="training samples before the first round")
    refit_last_layer: bool = Field(description="end each round with a ridge regression of the last layer")
    ridges: tuple[float, ...] = Field(
        min_length=1,
        description="of that regression, in standardised labels; each channel takes the one that does best"
        " on held-out samples, the first while there are too few",
    )
    position_label_floor_m_s2: float = Field(gt=0.0, description="m/s^2, least scale of position labels")
    attitude_label_floor_rad_s2: float = Field(gt=0.0, description="rad/s^2, least scale of attitude labels")


class GateConfig(ConfigRecord):
    """When a trained version is worth sending (control.md, section 7)."""

    trigger_unexplained: float = Field(
        ge=0.0, description="held-out loss of the flying version over the power of the labels, above which it may go"
    )
    margin: float = Field(ge=0.0, lt=1.0, description="by which the new version's held-out loss must be smaller")
    significance: float = Field(ge=0.0, description="standard errors by which it must be smaller")
    minimum_validation: int = Field(ge=2, description="held-out samples without which nothing is sent")
    interval_s: float = Field(ge=0.0, description="s, least time between two versions")


class ExperienceConfig(ConfigRecord):
    """What becomes of what was learnt."""

    mode: Literal["learn", "frozen"] = Field(description="frozen: fly what was loaded, learn nothing")
    checkpoint_period_s: float = Field(gt=0.0, description="s between checkpoints")


class PoseRelayConfig(ConfigRecord):
    """The motion capture and its clock."""

    latency_s: float = Field(ge=0.0, le=0.2, description="s, least time from capture to arrival here")
    position_limit_m: float = Field(gt=0.0, description="m, farther poses are not believed")


class OffboardConfig(ConfigRecord):
    """All of the offboard side."""

    vehicle_id: int = Field(ge=1, le=255)
    seed: int = Field(ge=0, description="of initial weights and mini-batches")
    labels: LabelConfig
    features: FeaturesConfig
    buffer: BufferConfig
    trainer: TrainerConfig
    gate: GateConfig
    experience: ExperienceConfig
    pose_relay: PoseRelayConfig
    transfer: TransferConfig
