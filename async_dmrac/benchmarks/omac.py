"""The learner alone on the quadrotor task of OMAC (Shi et al. 2021).

The task is the authors' own code, branch `quadsim` of github.com/GuanyaShi/Online-Meta-Adaptive-Control: a quadrotor
in a wind that changes every 2 s, and controllers that differ in how they estimate its force. Here `Learner` takes the
place of their estimate, in a subclass of their `MetaAdapt`; everything else stays theirs.
"""

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import numpy as np

from async_dmrac.learner import Learner
from configs.loader import ConfigError
from protocol.conventions import Array

WHERE: Final = (
    "get it with: git clone -b quadsim https://github.com/GuanyaShi/Online-Meta-Adaptive-Control; "
    "the folder is the one with threedeequadsim in it, "
    "and their code needs rowan, autograd, tqdm, torch and setuptools below 81"
)
PACKAGE: Final = "threedeequadsim"
STATE: Final = (
    *(f"p_{a}" for a in "xyz"),
    *(f"q_{k}" for k in "wxyz"),
    *(f"v_{a}" for a in "xyz"),
    *(f"w_{a}" for a in "xyz"),
)
"""Their X [13]: position, quaternion, velocity, body rates."""
FORCE: Final = ("f_x", "f_y", "f_z")
SCALES: Final = dict(zip(STATE, ((0.0, s) for s in (2.0,) * 3 + (1.0,) * 4 + (3.0,) * 3 + (2.0,) * 3), strict=True))
FORCE_N: Final = 3.0
"""Usual size of the force."""
SAMPLES_MIN: Final = 300
"""Of a first training: 6 s."""
ROUNDS: Final = 3
"""Of training, each time the wind changes."""
WIND: Final[dict[str, Any]] = {
    "Vwind": (5.0, 0.0, 0.0),
    "Vwind_cov": 7.5,
    "Vwind_gust": 5.0,
    "wind_constraint": "hard",
}
LAP_S: Final = 1.5 * np.pi
SEEDS: Final = (115, 116, 117, 118, 119)


@dataclass(frozen=True)
class TaskErrors:
    """Of one controller, mean over the seeds."""

    controller: str
    position_m: float
    """Mean distance to the target."""
    settled_m: float
    """The same in the second half."""


def compare(folder: Path, seconds: float = 60.0, seeds: tuple[int, ...] = SEEDS) -> list[TaskErrors]:
    """Fly their figure-8 in their wind with their baseline, their deep OMAC, their omniscient controller and Learner.

    Parameters
    ----------
    folder: with their package `threedeequadsim`. seconds: of each flight.

    Raises
    ------
    ConfigError
        If their code is not there, or cannot be imported.
    """
    with their_code(folder) as code:
        control = code["controller"]
        made = {
            "baseline": control.Baseline,
            "deep OMAC": lambda: control.MetaAdaptDeep(eta_a_base=0.005, eta_A_base=0.05, dim_a=50),
            "omniscient": lambda: control.Omniscient(baselinectrlparamfile=control.DEFAULT_CONTROL_PARAM_FILE),
            "Learner": learner_controller(control),
        }
        return [_fly(name, make, code, seconds, seeds) for name, make in made.items()]


def as_json(found: list[TaskErrors]) -> list[dict[str, Any]]:
    """One record per controller."""
    return [asdict(one) for one in found]


@contextmanager
def their_code(folder: Path) -> Iterator[Mapping[str, Any]]:
    """Import their modules from a folder; torch's default float type is theirs meanwhile.

    Raises
    ------
    ConfigError
        If the package is not there or cannot be imported.
    """
    if not (folder / PACKAGE / "quadsim.py").is_file():
        raise ConfigError(f"{folder}: no {PACKAGE}/quadsim.py of OMAC; {WHERE}")
    import torch

    before = torch.get_default_dtype()
    sys.path.insert(0, str(folder.resolve()))
    try:
        yield {name: import_module(f"{PACKAGE}.{name}") for name in ("controller", "quadsim", "trajectory")}
    except ImportError as error:
        raise ConfigError(f"{folder}: their code cannot be imported: {error}; {WHERE}") from None
    finally:
        sys.path.remove(str(folder.resolve()))
        for name in [name for name in sys.modules if name.partition(".")[0] == PACKAGE]:
            del sys.modules[name]
        torch.set_default_dtype(before)


def learner_controller(control: Any) -> type:
    """A subclass of their `MetaAdapt` that estimates the force with `Learner`.

    Its hooks: `get_f_hat(X)` predicts, `inner_adapt(X, fhat, y)` updates the last layer with the measured force y,
    `meta_adapt()` trains and swaps, once the wind has changed.
    """

    class LearnerControl(control.MetaAdapt):  # type: ignore[misc]
        _name = "learner"
        name_long = "Learner of async_dmrac"

        def reset_controller(self) -> None:
            super().reset_controller()
            sizes = dict.fromkeys(FORCE, FORCE_N)
            self.learner = Learner(STATE, FORCE, rate_hz=50.0, input_scales=SCALES, output_scales=sizes)
            self.seen = 0

        def get_f_hat(self, X: Array) -> Any:
            return control.Force(self.learner.predict(X))

        def inner_adapt(self, X: Array, fhat: Array, y: Array) -> None:
            self.learner.update(X, y)
            self.seen += 1

        def update_batch(self, X: Array, fhat: Array, y: Array) -> None:
            """`update` has collected the sample."""

        def meta_adapt(self) -> None:
            if self.seen >= SAMPLES_MIN:
                self.learner.fit(rounds=ROUNDS)

    return LearnerControl


def _fly(name: str, make: Any, code: Mapping[str, Any], seconds: float, seeds: tuple[int, ...]) -> TaskErrors:
    errors = []
    for seed in seeds:
        np.random.seed(seed)  # noqa: NPY002 their controllers draw from the global generator
        quadrotor = code["quadsim"].QuadrotorWithSideForce(**WIND, t_stop=seconds)
        log = quadrotor.run(make(), trajectory=code["trajectory"].fig8(T=LAP_S), show_progress=False, seed=seed)
        errors.append(np.linalg.norm(log["X"][:, :3] - log["pd"], axis=1))
    half = min(map(len, errors)) // 2
    return TaskErrors(
        name,
        float(np.mean([one.mean() for one in errors])),
        float(np.mean([one[half:].mean() for one in errors])),
    )
