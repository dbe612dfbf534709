"""Who may import whom, and what a core may touch: the rules of the house, read from the sources themselves."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = (
    "async_dmrac",
    "configs",
    "protocol",
    "onboard",
    "mambo",
    "offboard",
    "sim_vehicle",
    "flight_log",
    "runtime",
    "experiments",
)
HEAVY = {"torch", "numba", "mujoco", "matplotlib", "rerun", "pyarrow", "optuna", "sklearn", "distributed", "shtab"}
HEAVY |= {"foxglove", "rosbags", "tensorboard", "gymnasium", "pandas", "rotorpy"}
"""What only extras install; the base install (onboard) must live without."""

MAY_IMPORT: dict[str, tuple[str, ...]] = {
    "configs": (),
    "protocol": (),
    "onboard": ("configs", "protocol"),
    "mambo": ("configs", "protocol", "onboard", "runtime", "flight_log"),
    "offboard": ("configs", "protocol"),
    "sim_vehicle": ("configs", "protocol"),
    "flight_log": ("configs", "runtime"),
    "runtime": ("configs",),
    "experiments": PACKAGES[1:],
    "async_dmrac": PACKAGES,
}
MAY_IMPORT_ROOM: dict[str, tuple[str, ...]] = {
    "flights": (),
    "replays": ("flights",),
    "memory": ("flights", "replays"),
    "timing": ("flights", "campaigns"),
    "margins": ("flights",),
    "campaigns": ("flights", "margins", "memory"),
    "results": ("campaigns",),
    "link": ("flights", "replays", "campaigns", "results"),
    "attacks": ("flights", "campaigns"),
    "soak": ("flights", "link"),
}
"""The rooms of `experiments`, each with the other rooms that it may import."""
FOR_EVERYONE = ("configs.loader", "flight_log.schema")
MAY_NOT_USE: dict[str, set[str]] = {
    "configs": HEAVY,
    "protocol": HEAVY,
    "onboard": HEAVY,
    "mambo": HEAVY,
    "offboard": HEAVY - {"torch"},
    "sim_vehicle": HEAVY - {"numba", "mujoco", "rotorpy"},
    "flight_log": HEAVY - {"matplotlib", "rerun", "pyarrow", "foxglove", "rosbags", "tensorboard"},
    "runtime": HEAVY,
    "experiments": set(),
    "async_dmrac": set(),
}

SHELL_NAMES = {"process", "command", "__main__"}
NAMED_SHELLS = {
    "protocol.keys",
    "sim_vehicle.physics.compiled",
    "offboard.links.vehicle_service",
    "offboard.links.version_files",
    "offboard.background",
    "offboard.memory.folder",
    "onboard.c.compile",
    "onboard.c.declarations",
    "onboard.c.library",
}
"""Modules outside the shells' names that are shells, and why: key files; the compiler's cache; the offboard process's
part for each vehicle, its thread, and the folder of a memory; compiling, building and loading the C core."""
FOR_SHELLS = ("runtime.", "flight_log.writer")
WITH_CORES = ("protocol", "onboard", "offboard", "sim_vehicle")
NOT_IN_A_CORE = {
    *("asyncio", "concurrent", "ctypes", "multiprocessing", "queue", "random", "secrets", "select", "selectors"),
    *("signal", "socket", "ssl", "subprocess", "tempfile", "threading", "time", "uuid"),
}
NAMES_NOT_IN_A_CORE = {
    *("os.environ", "os.getenv", "os.urandom", "os.getpid", "datetime.now", "datetime.datetime.now"),
    *("torch.manual_seed", "torch.seed", "input", "open", "print"),
}
GENERATORS = {"BitGenerator", "Generator", "PCG64", "Philox", "SeedSequence", "default_rng"}
PURE_STANDARD_LIBRARY = {
    *("abc", "bisect", "collections", "dataclasses", "enum", "functools", "hashlib", "heapq", "hmac", "ipaddress"),
    *("itertools", "math", "operator", "struct", "types", "typing", "zlib"),
}
PROTOCOL_MAY_USE = {
    *("configs", "flight_log", "msgpack", "numpy", "protocol", "pydantic", "pymavlink"),
    *PURE_STANDARD_LIBRARY,
}


def is_shell(module: str) -> bool:
    return module.rpartition(".")[2] in SHELL_NAMES or module in NAMED_SHELLS


def imports(tree: ast.AST) -> Iterator[str]:
    """Every imported module; `from a import b` counts as `a.b`, which may be a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports hide who imports whom"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def border_faults(module: str, tree: ast.AST) -> Iterator[str]:
    package = module.partition(".")[0]
    for name in imports(tree):
        top = name.partition(".")[0]
        if top in MAY_NOT_USE[package]:
            yield f"{module} imports {top}"
        if top not in PACKAGES or top == package or top in MAY_IMPORT[package]:
            continue
        writes = is_shell(module) and name.startswith(("flight_log.writer", "runtime."))
        if not (writes or name.startswith(FOR_EVERYONE)):
            yield f"{module} imports {name}"


def room_faults(module: str, tree: ast.AST) -> Iterator[str]:
    """Imports of a room of `experiments` from another than the ones it may use."""
    room = module.split(".")[1]
    if room not in MAY_IMPORT_ROOM:
        yield f"{module} stands in no room of experiments"
        return
    for name in imports(tree):
        top, other = name.split(".")[:2] if "." in name else (name, "")
        if top == "experiments" and other != room and other not in MAY_IMPORT_ROOM[room]:
            yield f"{module} imports {name}"


def core_faults(module: str, tree: ast.AST) -> Iterator[str]:
    """What touches the world from a module that must not: imports, clocks, environment, global random state."""
    for name in imports(tree):
        top = name.partition(".")[0]
        if top in NOT_IN_A_CORE:
            yield f"{module} is a core and imports {top}"
        if module.startswith("protocol.") and top not in PROTOCOL_MAY_USE:
            yield f"{module} imports {top}"
    for node in ast.walk(tree):
        text = ast.unparse(node) if isinstance(node, ast.Attribute | ast.Call) else ""
        if isinstance(node, ast.Attribute) and (text in NAMES_NOT_IN_A_CORE or is_global_random(text)):
            yield f"{module} is a core and uses {text}"
        if isinstance(node, ast.Call) and ast.unparse(node.func) in NAMES_NOT_IN_A_CORE - {"torch.manual_seed"}:
            yield f"{module} is a core and calls {ast.unparse(node.func)}"
        if text.endswith("default_rng()"):
            yield f"{module} is a core and seeds from the operating system"


def is_global_random(text: str) -> bool:
    parts = text.split(".")
    return len(parts) == 3 and parts[:2] in (["np", "random"], ["numpy", "random"]) and parts[2] not in GENERATORS


def faults(module: str, source: str) -> list[str]:
    tree = ast.parse(source)
    found = list(border_faults(module, tree))
    if module.startswith(tuple(f"{package}." for package in WITH_CORES)) and not is_shell(module):
        found += core_faults(module, tree)
    if module.startswith("experiments."):
        found += room_faults(module, tree)
    found += [
        f"{module} imports {name}"
        for name in imports(tree)
        if name.startswith("async_dmrac.commands") and not module.startswith("async_dmrac.commands")
    ]
    return found


def modules() -> dict[str, Path]:
    paths = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    return {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in paths}


def test_every_module_keeps_the_rules() -> None:
    found = [fault for module, path in modules().items() for fault in faults(module, path.read_text(encoding="utf-8"))]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("protocol.codec", "import socket"),
        ("protocol.codec", "import yaml"),
        ("protocol.codec", "from onboard.core import OnboardCore"),
        ("onboard.core", "import torch.nn as nn"),
        ("onboard.process", "def f():\n    import torch"),
        ("onboard.core", "from flight_log.writer import FlightLogWriter"),
        ("onboard.core", "from runtime.sockets import DatagramSocket"),
        ("onboard.core", "from offboard import labels"),
        ("onboard.core", "import os\nx = os.environ['A']"),
        ("onboard.core", "from time import monotonic_ns"),
        ("onboard.core", "f = open('a')"),
        ("offboard.core", "import sim_vehicle.link.radio"),
        ("sim_vehicle.lockstep", "from onboard.core import OnboardCore"),
        ("sim_vehicle.world.world", "import numpy as np\nnp.random.normal()"),
        ("sim_vehicle.world.world", "import numpy as np\nrng = np.random.default_rng()"),
        ("flight_log.writer", "import torch"),
        ("experiments.flights.trace", "from experiments.campaigns.campaign import load_campaign"),
        ("experiments.campaigns.worker", "def f():\n    from experiments.results import tables"),
        ("experiments.link.link_page", "from async_dmrac.command_line import main"),
        ("async_dmrac.command_line", "import async_dmrac.commands.fly"),
        ("experiments.helpers", "import math"),
    ],
)
def test_the_rules_catch(module: str, source: str) -> None:
    assert faults(module, source)


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("protocol.transfer", "from configs.loader import ConfigRecord\nimport numpy as np\nimport hashlib"),
        ("onboard.process", "import socket, time\nfrom flight_log.writer import FlightLogWriter"),
        ("onboard.process", "from runtime.sockets import DatagramSocket"),
        ("onboard.core", "from flight_log.schema import RecordType"),
        ("sim_vehicle.world.world", "import numpy as np\nrng = np.random.default_rng([seed, 3])"),
        ("async_dmrac.commands.fly", "from onboard.core import OnboardCore\nimport offboard.core, time"),
    ],
)
def test_the_rules_allow(module: str, source: str) -> None:
    assert not faults(module, source)


IMPORT_ALL = """
import importlib, pkgutil, sys
packages, blocked = sys.argv[1].split(","), set(sys.argv[2].split(","))

class Block:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in blocked:
            raise ModuleNotFoundError(f"No module named {name!r} (blocked)", name=name)

sys.meta_path.insert(0, Block())
for package in packages:
    for module in pkgutil.walk_packages(importlib.import_module(package).__path__, package + "."):
        importlib.import_module(module.name)
"""


@pytest.mark.parametrize(
    ("packages", "blocked"),
    [
        ("onboard,protocol,configs", {*HEAVY, "offboard", "sim_vehicle", "experiments"}),
        ("sim_vehicle", {*HEAVY, "onboard", "offboard", "experiments"} - {"numba"}),
        ("offboard", {*HEAVY, "onboard", "sim_vehicle", "experiments"} - {"torch"}),
    ],
)
def test_a_package_runs_without_what_it_may_not_use(packages: str, blocked: set[str]) -> None:
    command = [sys.executable, "-c", IMPORT_ALL, packages, ",".join(sorted(blocked))]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr
