"""Settings of the offboard side with their units and default values; configs/features.yaml holds its `features`."""

from typing import Literal, Self

from pydantic import Field, model_validator

from configs.loader import ConfigRecord
from protocol.config import TransferConfig
from protocol.feature_config import FeaturesConfig
from protocol.signals import input_indices


class LabelConfig(ConfigRecord):
    """The labels: what the networks are trained to give (docs/learning.md)."""

    kind: Literal["residual", "mrgen"] = Field(
        default="residual", description="residual: the measured uncertainty; mrgen: nu_ad as it was flown (the paper)"
    )
    position_window_s: float = Field(default=0.12, gt=0.0, le=2.0, description="s, length of the smoothing window")
    attitude_window_s: float = Field(default=0.12, gt=0.0, le=2.0, description="s, length of the smoothing window")
    order: int = Field(default=1, ge=0, le=4, description="degree of the smoothing polynomial")
    reorder_s: float = Field(default=0.3, ge=0.0, le=2.0, description="s, longest wait for a missing sample")
    minimum_height_m: float = Field(default=0.15, ge=0.0, description="m above the floor; lower samples are not used")
    position_limit_m_s2: float = Field(default=20.0, gt=0.0, description="m/s^2, larger labels are not used")
    attitude_limit_rad_s2: float = Field(default=400.0, gt=0.0, description="rad/s^2, larger labels are not used")


class BufferConfig(ConfigRecord):
    """Which samples are stored (docs/learning.md)."""

    capacity: int = Field(default=1000, ge=8, le=4000, description="samples, p_max")
    admission: Literal["kernel", "history"] = Field(
        default="kernel", description="kernel: GP novelty; history: Chowdhary and Johnson"
    )
    deletion: Literal["svd", "fifo"] = Field(default="svd", description="which sample a full buffer deletes")
    novelty_inputs: tuple[str, ...] = Field(
        default=("position_n", "position_e", "position_d", "velocity_n", "velocity_e", "velocity_d"),
        min_length=1,
        description="signals that the kernel compares",
    )
    kernel_width: float = Field(default=0.3, gt=0.0, description="width of the Gaussian kernel, in scaled inputs")
    kernel_tolerance: float = Field(default=0.01, gt=0.0, lt=1.0, description="zeta_tol, smallest gamma that is new")
    history_tolerance: float = Field(default=0.02, gt=0.0, description="smallest norm(dPhi)^2 / norm(Phi) that is new")
    refresh_age_s: float = Field(default=4.0, gt=0.0, description="s; a similar sample replaces an older entry")
    newest: int = Field(default=400, ge=16, le=4000, description="samples, store of the newest, new or not")
    newest_scale: float = Field(default=150.0, gt=0.0, description="samples of age that make a draw 1/e as likely")
    newest_fraction: float = Field(default=0.3, ge=0.0, le=1.0, description="share of the newest in each mini-batch")
    block_s: float = Field(default=0.3, gt=0.0, le=10.0, description="s, length of a block; a block is in one split")
    blocks_per_group: int = Field(default=5, ge=3, description="blocks of a group; one of them is for validation")
    release_s: float = Field(default=5.0, gt=0.0, description="s; older validation samples are trained on")
    groups_per_test: int = Field(default=4, ge=1, description="groups of which one has a block for testing")

    @model_validator(mode="after")
    def _inputs_known(self) -> Self:
        input_indices(self.novelty_inputs)
        return self


class TrainerConfig(ConfigRecord):
    """How the networks are trained (docs/learning.md)."""

    optimiser: Literal["adam", "sgd"] = "adam"
    learning_rate: float = Field(default=0.005, gt=0.0)
    momentum: float = Field(default=0.9, ge=0.0, lt=1.0, description="of sgd")
    weight_decay: float = Field(default=3e-4, ge=0.0, description="l2 on all weights")
    batch_size: int = Field(default=128, ge=1, le=4096, description="M, samples per mini-batch")
    batches: int = Field(default=80, ge=1, le=10000, description="mini-batches per round")
    epochs: int = Field(default=4, ge=1, le=100, description="parts of a round; the losses are recorded after each")
    projection_every: int = Field(default=10, ge=1, description="mini-batches between two spectral projections")
    period_s: float = Field(default=0.5, ge=0.0, description="s, least time between starts of rounds")
    shared: bool = Field(
        default=True,
        description="one network for all vehicles of the process, a last layer for each; one vehicle: none",
    )
    minimum_samples: int = Field(default=300, ge=8, description="training samples before the first round")
    refit_last_layer: bool = Field(default=True, description="end each round with a ridge regression of the last layer")
    ridges: tuple[float, ...] = Field(
        default=(0.03, 0.1, 0.3, 1.0, 10.0),
        min_length=1,
        description="of that regression, in standardised labels; each channel takes the one that does best"
        " on held-out samples, the first while there are too few",
    )
    slope_weight: float = Field(
        default=0.0, ge=0.0, description="of the mean squared slope over the unit box, in units of the ridge; 0: none"
    )
    position_label_floor_m_s2: float = Field(default=0.2, gt=0.0, description="m/s^2, least scale of the labels")
    attitude_label_floor_rad_s2: float = Field(default=2.0, gt=0.0, description="rad/s^2, least scale of the labels")


class GateConfig(ConfigRecord):
    """When a trained version is sent (docs/learning.md)."""

    trigger: float = Field(
        default=0.2,
        ge=0.0,
        description="least gain in held-out loss over the flying version, per held-out loss that training leaves",
    )
    significance: float = Field(default=1.0, ge=0.0, description="standard errors by which the loss must be smaller")
    margin: float = Field(default=0.03, ge=0.0, lt=1.0, description="share by which a channel's loss may rise")
    minimum_validation: int = Field(default=20, ge=2, description="least held-out labels of each channel")
    interval_s: float = Field(default=1.0, ge=0.0, description="s, least time between two versions")


class ExperienceConfig(ConfigRecord):
    """Whether the offboard side learns, and how often it saves what it has learnt."""

    mode: Literal["learn", "frozen"] = Field(default="learn", description="frozen: fly what was loaded, learn nothing")
    checkpoint_period_s: float = Field(default=5.0, gt=0.0, description="s between checkpoints")
    versions_kept: int = Field(
        default=20, ge=1, le=100_000, description="files features_N.npz: older ones of the flight are deleted"
    )
    memory: str = Field(default="", description="folder of the memory to start from; empty: none (docs/memory.md)")
    remember: bool = Field(default=False, description="add the flight to that memory when the process ends")

    @model_validator(mode="after")
    def _memory_to_remember_in(self) -> Self:
        if self.remember and not self.memory:
            raise ValueError("remember: true needs memory, the folder of the memory")
        return self


class PoseRelayConfig(ConfigRecord):
    """The motion capture and its clock."""

    latency_s: float = Field(
        default=0.010, ge=0.0, le=0.2, description="s, least time from capture to arrival here, as in the simulation"
    )
    position_limit_m: float = Field(default=50.0, gt=0.0, description="m, farther poses are refused")
    signing_tolerance_s: float = Field(
        default=60.0, gt=0.0, description="s; signing clock of the motion capture against this machine's"
    )


class OffboardConfig(ConfigRecord):
    """Settings of the offboard side."""

    vehicle_id: int = Field(default=1, ge=1, le=255)
    seed: int = Field(default=1, ge=0, description="of initial weights and mini-batches")
    labels: LabelConfig = LabelConfig()
    features: FeaturesConfig
    buffer: BufferConfig = BufferConfig()
    trainer: TrainerConfig = TrainerConfig()
    gate: GateConfig = GateConfig()
    experience: ExperienceConfig = ExperienceConfig()
    pose_relay: PoseRelayConfig = PoseRelayConfig()
    transfer: TransferConfig = TransferConfig()
