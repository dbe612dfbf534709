"""The learner in OMAC's task, on a stand-in of its code with the same names and hooks (made here, not theirs)."""

import sys
from pathlib import Path

import pytest
import torch

from async_dmrac.benchmarks.omac import compare, learner_controller, their_code
from async_dmrac.command_line import main
from configs.loader import ConfigError

CONTROLLER = """
from collections import namedtuple
import numpy as np
import torch
torch.set_default_dtype(torch.float64)  # theirs does so, too

Force = namedtuple("Force", "F F_dot F_ddot", defaults=(np.zeros(3), np.zeros(3)))
DEFAULT_CONTROL_PARAM_FILE = "controller.json"

class Baseline:
    K_p, K_d = 6.0, 4.0
    def __init__(self, ctrlparamfile=None, integral_control=True):
        self.integral_control = integral_control
    def reset_controller(self):
        self.last = None
    def position(self, X, imu, pd, vd, ad, t_last_wind_update, logentry):
        trigger = self.last is not None and t_last_wind_update > self.last
        self.last = t_last_wind_update
        return self.get_Fr(X, imu=imu, pd=pd, vd=vd, ad=ad, meta_adapt_trigger=trigger, logentry=logentry).F
    def get_Fr(self, X, imu, pd, vd, ad, logentry=None, **kwargs):
        return Force(ad - self.K_p * (X[:3] - pd) - self.K_d * (X[7:10] - vd))

class MetaAdapt(Baseline):
    def get_Fr(self, X, *, meta_adapt_trigger, imu, pd, vd, ad, logentry=None, **kwargs):
        y, fhat = imu, self.get_f_hat(X)
        self.inner_adapt(X, fhat.F, y)
        self.update_batch(X, fhat.F, y)
        if meta_adapt_trigger:
            self.meta_adapt()
        return Force(super().get_Fr(X, imu, pd, vd, ad).F - self.get_f_hat(X).F)

class MetaAdaptDeep(MetaAdapt):
    def __init__(self, dim_a, eta_a_base, eta_A_base):
        self.rate = eta_a_base
    def reset_controller(self):
        super().reset_controller()
        self.f = np.zeros(3)
    def get_f_hat(self, X):
        return Force(self.f)
    def inner_adapt(self, X, fhat, y):
        self.f = self.f + self.rate * (y - fhat)
    def update_batch(self, X, fhat, y):
        pass
    def meta_adapt(self):
        pass

class Omniscient(Baseline):
    def __init__(self, baselinectrlparamfile):
        super().__init__(integral_control=False)
    def get_Fr(self, X, imu, pd, vd, ad, logentry=None, **kwargs):
        return Force(super().get_Fr(X, imu, pd, vd, ad).F - logentry["Fs"])
"""
QUADSIM = """
import numpy as np

class QuadrotorWithSideForce:
    def __init__(self, Vwind, Vwind_cov, Vwind_gust, wind_constraint, t_stop):
        assert wind_constraint == "hard" and type(Vwind_gust) is float
        self.wind, self.t_stop = np.array(Vwind), t_stop
    def run(self, controller, trajectory, show_progress=True, seed=None):
        np.random.seed(seed)
        controller.reset_controller()
        X, log, changed, dt = np.zeros(13), [], 0.0, 0.02
        X[3] = 1.0
        for t in np.arange(0.0, self.t_stop, dt):
            if t - changed > 2.0:
                self.wind, changed = np.array([5.0, 0.0, 0.0]) + np.random.uniform(-5.0, 5.0, 3), t
            force = 0.5 * (self.wind - X[7:10])
            pd, vd, ad, *_ = trajectory(t)
            entry = {"Fs": force}
            u = controller.position(X, imu=force, pd=pd, vd=vd, ad=ad, t_last_wind_update=changed, logentry=entry)
            X = X.copy()
            X[:3] += dt * X[7:10]
            X[7:10] += dt * (u + force)
            log.append((X, pd))
        return {"X": np.array([x for x, _ in log]), "pd": np.array([p for _, p in log])}
"""
TRAJECTORY = """
import numpy as np

class fig8:
    def __init__(self, T):
        self.w = 2.0 * np.pi / T
    def __call__(self, t):
        w, a, b = self.w, np.array([2.0, 2.0, 0.0]), np.array([0.0, 0.0, 1.0])
        s, c, s2, c2 = np.sin(w * t), np.cos(w * t), np.sin(2 * w * t), np.cos(2 * w * t)
        zero = np.zeros(3)
        return s * a + s2 * b, w * (c * a + 2 * c2 * b), -w * w * (s * a + 4 * s2 * b), zero, zero
"""


@pytest.fixture
def code(tmp_path: Path) -> Path:
    package = tmp_path / "threedeequadsim"
    package.mkdir()
    for name, text in {"__init__": "", "controller": CONTROLLER, "quadsim": QUADSIM, "trajectory": TRAJECTORY}.items():
        (package / f"{name}.py").write_text(text)
    return tmp_path


def test_the_learner_follows_the_wind_better_than_the_baseline(code: Path) -> None:
    found = {one.controller: one for one in compare(code, seconds=12.0, seeds=(115,))}
    assert set(found) == {"baseline", "deep OMAC", "omniscient", "Learner"}
    assert found["Learner"].settled_m < 0.3 * found["baseline"].settled_m
    assert found["Learner"].settled_m < 1.2 * found["omniscient"].settled_m


def test_it_trains_when_the_wind_has_changed(code: Path) -> None:
    with their_code(code) as modules:
        controller = learner_controller(modules["controller"])()
        quadrotor = modules["quadsim"].QuadrotorWithSideForce((5.0, 0.0, 0.0), 7.5, 5.0, "hard", t_stop=7.0)
        quadrotor.run(controller, modules["trajectory"].fig8(T=4.7), seed=1)
    assert controller.learner.version == 1  # at 6.06 s; at 2.02 and 4.04 s there are too few samples


def test_their_code_leaves_nothing_behind(code: Path) -> None:
    before = list(sys.path)
    with their_code(code):
        assert torch.get_default_dtype() == torch.float64
    assert torch.get_default_dtype() == torch.float32
    assert sys.path == before
    assert not [name for name in sys.modules if name.startswith("threedeequadsim")]


def test_code_that_is_missing_or_broken_is_an_error_that_says_where_to_get_it(
    tmp_path: Path, code: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "omac"]) == 2
    assert main(["bench", "omac", "--code", str(tmp_path / "nowhere")]) == 2
    assert capsys.readouterr().err.count("git clone -b quadsim") == 2
    (code / "threedeequadsim" / "quadsim.py").write_text("import rowan_that_is_not_there")
    with pytest.raises(ConfigError, match="No module named 'rowan_that_is_not_there'"), their_code(code):
        pass
