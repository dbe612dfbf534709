"""Onboard and offboard in two network namespaces, joined by a veth pair: a real IP path between two addresses, a key,
and its impairment by the kernel (`tc netem`) beside our own radio's of the same kind.

Skipped with a reason where namespaces, `ip`, `tc` or netem are not to be had.
"""

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from experiments.flights.scenario import Choices, FlightConfig, resolve
from flight_record.reader import open_flight
from protocol.keys import write_key
from tests.experiments.processes import Processes

pytestmark = [pytest.mark.realtime, pytest.mark.full]

DURATION_S = 16.0
LOSS = 0.1
VEHICLE, GROUND = f"dmrac{os.getpid()}a", f"dmrac{os.getpid()}b"
"""The namespaces: vehicle and onboard in one, offboard in the other."""
LINK = ("10.201.1.1", "10.201.1.2")
CAPTURE = ("10.201.2.1", "10.201.2.2")
"""The motion capture has a cable of its own, which is never impaired."""
NETEM = ("delay", "10ms", "3ms", "loss", f"{LOSS:.0%}", "reorder", "5%")
RADIO = {"loss": LOSS, "delay_s": 0.01, "jitter_s": 0.003, "reordering": 0.05}


def ip(*words: str) -> None:
    """Runs `ip`; skips the test where it is refused."""
    result = subprocess.run(("ip", *words), capture_output=True, text=True, check=False)
    if result.returncode:
        pytest.skip(f"ip {' '.join(words)}: {result.stderr.strip() or 'refused'}")


@pytest.fixture
def namespaces() -> Iterator[None]:
    """Two namespaces, two cables."""
    if shutil.which("ip") is None or shutil.which("tc") is None:
        pytest.skip("ip and tc (iproute2) are not installed")
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
            subprocess.run(("ip", "netns", "delete", name), capture_output=True, check=False)


def impair_by_kernel() -> None:
    """Netem on both ends of the link; skips where the kernel has none."""
    for name in (VEHICLE, GROUND):
        words = ("tc", "-n", name, "qdisc", "add", "dev", "radio0", "root", "netem", *NETEM)
        result = subprocess.run(words, capture_output=True, text=True, check=False)
        if result.returncode:
            pytest.skip(f"tc netem: {result.stderr.strip().splitlines()[0]}")


def configs(tmp_path: Path, with_radio: bool) -> tuple[Path, Path]:
    """The configuration for onboard and offboard, and that for the simulated vehicle."""
    key = tmp_path / "flight.key"
    write_key(key)
    config = resolve("figure8_calm", Choices("dmrac", 4, DURATION_S, ("radio={up: {}, down: {}}",)))
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
    common = {"offboard_link": f"{LINK[1]}:15573", "motion_capture": f"{CAPTURE[1]}:15574", "key_file": str(key)}
    impaired = config.radio.model_validate({"up": RADIO, "down": RADIO}) if with_radio else config.radio
    config = with_network(config, common | (radio if with_radio else direct)).model_copy(update={"radio": impaired})
    path, path_of_sim = tmp_path / "config.yaml", tmp_path / "sim.yaml"
    path.write_text(config.to_yaml(), encoding="utf-8")
    path_of_sim.write_text(with_network(config, common | radio).to_yaml(), encoding="utf-8")
    return path, path_of_sim


def with_network(config: FlightConfig, addresses: dict[str, str]) -> FlightConfig:
    network = config.network.model_validate(config.network.model_dump() | addresses)
    return config.model_copy(update={"network": network})


@pytest.mark.parametrize("impaired_by", ["radio", "kernel"])
def test_a_flight_across_two_namespaces(namespaces: None, impaired_by: str, tmp_path: Path) -> None:
    if impaired_by == "kernel":
        impair_by_kernel()
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
    received, features = offboard["received"], onboard["features"]
    print(f"impaired by {impaired_by}: {share:.1%} lost up, {received} received, features {features}")
    assert share == pytest.approx(LOSS, abs=0.06)
    assert offboard["poses_relayed"] > 500
    tick = open_flight(tmp_path)["onboard/tick"]
    flying = tick["path_time"] > 0.0
    assert (tick["pose_age"][flying] < 0.2).mean() > 0.95, "poses come through"
    assert onboard["features"]["swaps"] >= 1, "and so do features"
