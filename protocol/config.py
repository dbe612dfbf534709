"""Configuration of the link."""

from typing import Literal

from pydantic import Field

from configs.loader import ConfigRecord
from protocol.messages import CHUNK_DATA_MAX_BYTES


class TransferConfig(ConfigRecord):
    """How feature sets are sent."""

    dtype: Literal["float16", "float32"] = Field(default="float16", description="size of the parameters on the link")
    chunk_bytes: int = Field(
        default=CHUNK_DATA_MAX_BYTES, ge=64, le=CHUNK_DATA_MAX_BYTES, description="size of a chunk"
    )
    chunks_per_second: float = Field(default=40.0, gt=0.0, le=2000.0, description="rate; 40 is at most 0.4 Mbit/s")
    chunks_per_poll: int = Field(default=4, ge=1, le=64, description="most chunks sent in one call")
    resend_after_s: float = Field(
        default=0.04,
        gt=0.0,
        le=10.0,
        description="s, a chunk that is missing this long after it was sent is sent again; near the round trip",
    )
    resend_max_s: float = Field(default=1.0, gt=0.0, le=60.0, description="s, longest back-off interval without status")
