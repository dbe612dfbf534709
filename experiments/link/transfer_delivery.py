"""Measures how long a feature set takes across a lossy link: `python -m experiments.link.transfer_delivery --out DIR`.

A pair of 6-32-32-20 networks goes through the real sender, endpoints, radio and receiver in virtual time, with the same
independent loss in both directions. The result is compared with an ideal erasure code: any k different chunks suffice,
and nothing is sent twice. No real code is faster at the same pace.
"""

import argparse
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from experiments.results.figure_style import finish, new_figure
from protocol.config import TransferConfig
from protocol.endpoint import Endpoint
from protocol.feature_set import ChannelFeatures, FeatureSet
from protocol.messages import FeatureChunk, Status
from protocol.transfer import FeatureReceiver, FeatureSender
from sim_vehicle.link.radio import DirectionConfig, Radio, RadioConfig

LOSSES: Final = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
WIDTHS: Final = (6, 32, 32, 20)
INPUTS: Final = ("velocity_n", "velocity_e", "velocity_d", "roll", "pitch", "yaw")
STEP_NS: Final = 5_000_000
STATUS_PERIOD_NS: Final = 100_000_000
DELAY_S: Final = 0.01
LIMIT_NS: Final = 120_000_000_000

FloatName = Literal["float16", "float32"]


class TransferTime(NamedTuple):
    """The cost of one transfer."""

    seconds: float
    """From the offer to the complete and verified set on board."""
    chunks: int
    """Chunks sent until the sender received the confirmation."""


def network_pair(rng: np.random.Generator) -> FeatureSet:
    """Return two networks with random parameters."""

    def channel() -> ChannelFeatures:
        weights = tuple(rng.normal(size=(out, into)) / into**0.5 for into, out in pairwise(WIDTHS))
        biases = tuple(rng.normal(size=out) for out in WIDTHS[1:])
        return ChannelFeatures(INPUTS, np.zeros(6), np.ones(6), weights, biases, rng.normal(size=(WIDTHS[-1] + 1, 3)))

    return FeatureSet(1, 0, 1000, channel(), channel())


def transfer(loss: float, dtype: FloatName, seed: int) -> TransferTime:
    """Make one transfer with bitmap repair at the default pace."""
    rng = np.random.default_rng([seed, 0])
    way = DirectionConfig(loss=loss, delay_s=DELAY_S)
    radio = Radio(RadioConfig(up=way, down=way), np.random.default_rng([seed, 1]))
    onboard, offboard = Endpoint("onboard", 1, None), Endpoint("offboard", 1, None)
    sender, receiver = FeatureSender(TransferConfig(dtype=dtype)), FeatureReceiver()
    next_status_ns = int(rng.integers(0, STATUS_PERIOD_NS))
    sender.offer(network_pair(rng), 0)
    whole_ns = LIMIT_NS
    for now_ns in range(0, LIMIT_NS, STEP_NS):
        for datagram in radio.due("down", now_ns):
            chunk = onboard.decode(datagram, now_ns)
            if isinstance(chunk, FeatureChunk) and receiver.receive(chunk) is not None:
                whole_ns = now_ns
        for datagram in radio.due("up", now_ns):
            status = offboard.decode(datagram, now_ns)
            if isinstance(status, Status):
                sender.receive_status(status, now_ns)
        if not sender.outstanding_version:
            break
        if now_ns >= next_status_ns:
            next_status_ns += STATUS_PERIOD_NS
            status = Status(0, 0, receiver.transfer_version, receiver.received_chunks, 0, 0, 0, 0, -1, 0, 0, 0)
            radio.send("up", onboard.encode(status, now_ns), now_ns)
        for chunk in sender.poll(now_ns):
            radio.send("down", offboard.encode(chunk, now_ns), now_ns)
    return TransferTime(whole_ns * 1e-9, sender.chunks_sent)


def ideal_transfer(loss: float, chunk_count: int, seed: int) -> TransferTime:
    """Make one transfer with an ideal erasure code: it ends when the k-th chunk arrives."""
    rng = np.random.default_rng([seed, 2])
    config = TransferConfig()
    arrived = np.cumsum(rng.random(100_000) >= loss)
    sent_when_whole = int(np.searchsorted(arrived, chunk_count)) + 1
    paced = max(0, sent_when_whole - config.chunks_per_poll)  # the first poll sends a burst
    whole_s = paced / config.chunks_per_second + DELAY_S
    statuses = 1 + int(np.argmax(rng.random(10_000) >= loss))  # until a confirmation arrives
    known_s = whole_s + (statuses - rng.random()) * STATUS_PERIOD_NS * 1e-9 + DELAY_S
    return TransferTime(whole_s, sent_when_whole + int((known_s - whole_s + DELAY_S) * config.chunks_per_second))


def measure(seeds: int) -> dict[str, NDArray[np.float64]]:
    """Return seconds and chunks by name, [losses, seeds, 2]."""

    def all_of(one: Any) -> NDArray[np.float64]:
        return np.array([[one(loss, seed) for seed in range(seeds)] for loss in LOSSES])

    return {
        "float16, repair": all_of(lambda loss, seed: transfer(loss, "float16", seed)),
        "float16, ideal code": all_of(lambda loss, seed: ideal_transfer(loss, 8, seed)),
        "float32, repair": all_of(lambda loss, seed: transfer(loss, "float32", seed)),
        "float32, ideal code": all_of(lambda loss, seed: ideal_transfer(loss, 15, seed)),
    }


def table(results: dict[str, NDArray[np.float64]]) -> str:
    """Return a Markdown table: median / 95th percentile of the seconds, and mean number of chunks."""
    lines = ["| loss each way | " + " | ".join(results) + " |", "|---" * (len(results) + 1) + "|"]
    for row, loss in enumerate(LOSSES):
        cells = []
        for values in results.values():
            seconds, chunks = values[row, :, 0], values[row, :, 1]
            cells.append(f"{np.median(seconds):.2f} / {np.quantile(seconds, 0.95):.2f} s, {chunks.mean():.1f}")
        lines.append(f"| {loss:.0%} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def draw(results: dict[str, NDArray[np.float64]], path: Path) -> None:
    """Draw median and 95th percentile of the transfer time against loss."""
    figure = new_figure(4.2, 7.0)
    axes = figure.add_subplot()
    for index, (name, values) in enumerate(results.items()):
        colour, style = ("#0072b2", "#d55e00")[index // 2], ("-", "--")[index % 2]
        median, high = np.quantile(values[:, :, 0], (0.5, 0.95), axis=1)
        axes.plot(LOSSES, median, color=colour, linestyle=style, marker=".", label=name)
        if index % 2 == 0:
            axes.fill_between(LOSSES, median, high, color=colour, alpha=0.15, linewidth=0)
    axes.set_yscale("log")
    axes.axhline(2.0, color="0.6", linewidth=0.8)
    y_label = "transfer time [s]\n(median; shaded up to the 95th percentile)"
    finish(axes, "independent loss in each direction", y_label, "A pair of 6-32-32-20 networks at 40 chunks/s")
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print the table and draw the figure."""
    parser = argparse.ArgumentParser(description="Transfer time of a feature set against loss.")
    parser.add_argument("--seeds", type=int, default=200, help="transfers per point (default 200)")
    parser.add_argument("--out", type=Path, default=Path("docs/pictures"), help="folder for transfer_delivery.png")
    options = parser.parse_args(arguments)
    results = measure(options.seeds)
    print(table(results))
    options.out.mkdir(parents=True, exist_ok=True)
    draw(results, options.out / "transfer_delivery.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
