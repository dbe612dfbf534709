"""The quality of a link, from the deliveries of its datagrams."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim_vehicle.link.radio import Delivery


@dataclass(frozen=True)
class LinkQuality:
    """One direction of a link over a flight."""

    sent: int
    lost: int
    longest_gap_s: float
    """Longest time without an arrival, including the times before the first and after the last one."""
    longest_burst: int
    """Largest number of consecutive lost datagrams."""
    delay_median_s: float
    """Of the datagrams that arrived; NaN for none."""
    bytes_per_s: float

    @property
    def lost_share(self) -> float:
        """Lost / sent; 0 if nothing was sent."""
        return self.lost / self.sent if self.sent else 0.0


def link_quality(deliveries: Sequence[Delivery], duration_s: float) -> LinkQuality:
    """Return the quality of one direction.

    Parameters
    ----------
    deliveries: in the order sent; times since the start of the flight.
    duration_s: of the flight.
    """
    lost = np.array([delivery.outcome != "delivered" for delivery in deliveries], dtype=bool)
    arrived = [delivery for delivery in deliveries if delivery.outcome == "delivered"]
    delays = np.array([delivery.delay_ns for delivery in arrived], dtype=np.float64) * 1e-9
    arrivals = sorted((delivery.sent_ns + delivery.delay_ns) * 1e-9 for delivery in arrived)
    marks = np.array([0.0, *(time for time in arrivals if time < duration_s), max(duration_s, 0.0)])
    return LinkQuality(
        sent=len(deliveries),
        lost=int(lost.sum()),
        longest_gap_s=float(np.diff(marks).max()),
        longest_burst=_longest_run(lost),
        delay_median_s=float(np.median(delays)) if delays.size else float("nan"),
        bytes_per_s=sum(delivery.size_bytes for delivery in deliveries) / max(duration_s, 1e-9),
    )


def _longest_run(flags: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> int:
    edges = np.diff(np.concatenate([[0], flags.astype(np.int8), [0]]))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return int((ends - starts).max()) if starts.size else 0
