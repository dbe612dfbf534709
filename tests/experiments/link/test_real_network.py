"""Onboard and offboard in two network namespaces, connected by a veth pair: a real IP path between two addresses.

With a key, and with impairments by the kernel beside those of the simulated radio. The kernel uses netem (loss, delay,
reordering) and, since not every kernel has it, nftables and a token bucket: the receiver's packet filter drops at
random, and the sender's queue is narrow. The test skips what the machine does not support, with the reason.
"""

import contextlib
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from experiments.flights.scenario import Choices, FlightConfig, resolve
from flight_log.reader import open_flight
from protocol.keys import write_key
from tests.experiments.processes import Processes

pytestmark = [pytest.mark.realtime, pytest.mark.full]

DURATION_S = 16.0
LOSS = 0.1
VEHICLE, GROUND = f"dmrac{os.getpid()}a", f"dmrac{os.getpid()}b"
"""The namespaces: vehicle and onboard in one, offboard in the other."""
LINK = ("10.201.1.1", "10.201.1.2")
CAPTURE = ("10.201.2.1", "10.201.2.2")
"""The motion capture has its own cable, which is never impaired."""
NETEM = ("netem", "delay", "10ms", "3ms", "loss", f"{LOSS:.0%}", "reorder", "5%")
NARROW = ("tbf", "rate", "700kbit", "burst", "2500", "latency", "100ms")
DROPS = (
    "table ip link { chain arriving { type filter hook input priority 0;"
    f" iifname radio0 numgen random mod 1000 < {1000 * LOSS:.0f} drop; }}; }}"
)
"""On arrival: if a filter drops datagrams on the way out, the sender gets an error, unlike with a radio."""
NOT_HERE = ("not permitted", "denied", "kind is unknown", "not supported", "No such file or directory")
"""Messages of ip, tc and nft for a feature that the machine does not support; any other message is a test failure."""
RADIO = {"loss": LOSS, "delay_s": 0.01, "jitter_s": 0.003, "reordering": 0.05}


def run(*words: str) -> None:
    """Runs a system tool; skips the test if the tool, the permission or the kernel feature is missing."""
    try:
        result = subprocess.run(words, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        pytest.skip(f"{words[0]} is not installed")
    if any(reason in result.stderr for reason in NOT_HERE):
        pytest.skip(f"{words[0]}: {result.stderr.strip().splitlines()[0]}")
    assert result.returncode == 0, result.stderr


def ip(*words: str) -> None:
    run("ip", *words)


@pytest.fixture
def namespaces() -> Iterator[None]:
    """Two namespaces, two cables."""
    try:
        for name in (VEHICLE, GROUND):
            ip("netns", "add", name)
            ip("-n", name, "link", "set", "lo", "up")
        for cable, (here, there) in (("radio0", LINK), ("capture0", CAPTURE)):
            ip("-n", VEHICLE, "link", "add", cable, "type", "veth", "peer", "name", cable, "netns", GROUND)
            for name, address in ((VEHICLE, here), (GROUND, there)):
                ip("-n", name, "address", "add", f"{address}/24", "dev", cable)
                ip("-n", name, "link", "set", cable, "up")
        yield
    finally:
        for name in (VEHICLE, GROUND):
            with contextlib.suppress(FileNotFoundError):
                subprocess.run(("ip", "netns", "delete", name), capture_output=True, check=False)


def impair_by_netem() -> None:
    """Both ends of the link lose, delay and reorder sent datagrams."""
    for name in (VEHICLE, GROUND):
        run("tc", "-n", name, "qdisc", "add", "dev", "radio0", "root", *NETEM)


def impair_by_nftables() -> None:
    """Both ends lose arriving datagrams; sent ones wait in a narrow queue."""
    for name in (VEHICLE, GROUND):
        ip("netns", "exec", name, "nft", DROPS)
        run("tc", "-n", name, "qdisc", "add", "dev", "radio0", "root", *NARROW)


KERNEL = {"netem": impair_by_netem, "nftables": impair_by_nftables}


def configs(tmp_path: Path, with_radio: bool) -> tuple[Path, Path]:
    """The configuration for onboard and offboard, and that for the simulated vehicle."""
    key = tmp_path / "flight.key"
    write_key(key)
    config = resolve(
        "figure8_calm",
        Choices("dmrac", 4, DURATION_S, ("radio={up: {}, down: {}}", "offboard.trainer.minimum_samples=60")),
    )
    radio = {
        "radio_onboard": "127.0.0.1:15570",
        "radio_offboard": f"{LINK[0]}:15572",
        "onboard_link": "127.0.0.1:15571",
    }
    direct = {
        "radio_onboard": f"{LINK[1]}:15573",
        "radio_offboard": f"{LINK[0]}:15571",
        "onboard_link": f"{LINK[0]}:15571",
    }
    common = {"offboard_link": f"{LINK[1]}:15573", "motion_capture": f"{CAPTURE[1]}:15574"}
    common |= {"key_file": str(key), "capture_key_file": str(key)}
    impaired = config.radio.model_validate({"up": RADIO, "down": RADIO}) if with_radio else config.radio
    config = with_network(config, common | (radio if with_radio else direct)).model_copy(update={"radio": impaired})
    path, path_of_sim = tmp_path / "config.yaml", tmp_path / "sim.yaml"
    path.write_text(config.to_yaml(), encoding="utf-8")
    path_of_sim.write_text(with_network(config, common | radio).to_yaml(), encoding="utf-8")
    return path, path_of_sim


def with_network(config: FlightConfig, addresses: dict[str, str]) -> FlightConfig:
    network = config.network.model_validate(config.network.model_dump() | addresses)
    return config.model_copy(update={"network": network})


@pytest.mark.parametrize("impaired_by", ["radio", *KERNEL])
def test_a_flight_across_two_namespaces(namespaces: None, impaired_by: str, tmp_path: Path) -> None:
    KERNEL.get(impaired_by, lambda: None)()
    config, config_of_sim = configs(tmp_path, impaired_by == "radio")
    inside = {name: ("ip", "netns", "exec", name) for name in (VEHICLE, GROUND)}
    with Processes(tmp_path) as processes:
        processes.start("sim", config_of_sim, prefix=inside[VEHICLE])
        processes.start("offboard", config, prefix=inside[GROUND])
        processes.start("onboard", config, prefix=inside[VEHICLE])
        assert processes.wait("sim", DURATION_S + 30.0) == 0
        processes.end("onboard", "offboard")
        sim, onboard, offboard = (processes.summary(name) for name in ("sim", "onboard", "offboard"))
    assert sim["survived"], sim["crash_reason"]
    assert onboard["escapes"] == 0
    assert onboard["rejected"].get("mac", 0) == 0, "the key is the same on both sides"
    share = offboard["lost"] / (offboard["lost"] + offboard["received"])
    assert share == pytest.approx(LOSS, abs=0.06)
    assert offboard["poses_relayed"] > 500
    tick = open_flight(tmp_path)["onboard/tick"]
    flying = tick["path_time"] > 0.0
    pose_age_s = tick["pose_age"][flying]
    ages = ", ".join(f"{1000 * age:.0f}" for age in np.quantile(pose_age_s, (0.5, 0.95)))
    received, swaps = offboard["received"], onboard["features"]["swaps"]
    print(f"impaired by {impaired_by}: {share:.1%} lost up, {received} received, pose age {ages} ms, {swaps} swaps")
    assert (pose_age_s < 0.2).mean() > 0.95, "poses come through"
    assert onboard["features"]["swaps"] >= 1, "and so do features"
