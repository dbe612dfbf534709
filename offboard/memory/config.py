"""Settings of `dmrac learn`, with their units and default values."""

from pydantic import Field

from configs.loader import ConfigRecord


class MemoryConfig(ConfigRecord):
    """How a memory is learnt (docs/memory.md)."""

    seed: int = Field(default=1, ge=0, description="of initial weights and of the draws")
    steps: int = Field(default=1000, ge=0, le=100_000, description="gradient steps; 0: the inner layers stay")
    conditions_per_step: int = Field(default=12, ge=1, le=512, description="E, drawn with replacement")
    samples_per_condition: int = Field(default=64, ge=8, le=600, description="n, samples of each in a step")
    learning_rate: float = Field(default=0.003, gt=0.0, description="of Adam; falls to a twentieth at the end")
    weight_decay: float = Field(default=1e-5, ge=0.0, description="l2 on the inner layers' weights")
