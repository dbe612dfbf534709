"""The watch over one channel: the law that learns against the bias-only law, which is computed beside it all the time.

The bias-only law has Phi = 1:  d_dot = lambda (r - d), r the residual; no byte from offboard is in it. While it flies,
d also has the tracking term of the law, - gamma e'PB. Two things are compared, in units of u:

- **misfit**: what was commanded a lag ago against the residual that came, norm(nu_cmd(t - lag) - Delta_hat(t)), and the
  same with d, and with 0. A map that sees ahead is better here than any law without one; a wrong one is worse.
- **e**, weighted as the loop weighs it: norm(K_1 e_1 + K_2 e_2), with e of the flight as it is, and with the e that the
  other law would have had. It follows from (1) by superposition: e_other = e + delta, delta_dot = A_rm delta +
  B (nu_other - nu_flown).

Both are root mean squares over `average_s`. A law is worse than another if either exceeds `margin` times that of the
other and the floor, which stands above the noise. Evidence counts only ticks in which the two laws disagree by more
than the noise: a map that says the same as a bias has shown nothing. Over `trial_s` of evidence the noise averages out:
there a map may be worse by `trial_margin` at most, with no floor.
"""

from collections import deque
from math import exp, sqrt
from typing import Annotated, Final

from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.laws.law import ChannelState
from protocol.conventions import Array
from protocol.geometry import Vector3, vector

Seconds = Annotated[float, Field(gt=0, le=30)]
Lag = Annotated[float, Field(gt=0, le=1)]
Size = Annotated[float, Field(gt=0, le=1e3)]
STRIDE: Final = 4
"""Ticks between two comparisons. The bias-only law itself runs in each."""
REST: Vector3 = (0.0, 0.0, 0.0)


class WatchConfig(ConfigRecord):
    """Probation. Pairs: position channel (m/s^2), attitude channel (rad/s^2)."""

    enabled: Annotated[bool, Field(description="false: ablation, no law is taken back in flight")] = True
    lag_s: Annotated[tuple[Lag, Lag], Field(description="s, from nu_cmd to its effect")] = (0.14, 0.05)
    average_s: Annotated[Seconds, Field(description="s, of the mean squares")] = 0.1
    margin: Annotated[float, Field(ge=1, le=10, description="worse: so many times the other law's")] = 1.5
    misfit_floor: Annotated[tuple[Size, Size], Field(description="plus this, units of u")] = (1.2, 20.0)
    error_floor: Annotated[tuple[Size, Size], Field(description="the same for e, units of u")] = (1.2, 20.0)
    trial_s: Annotated[Seconds, Field(description="s of evidence, over which a map is compared without a floor")] = 1.0
    trial_margin: Annotated[
        float, Field(ge=1, le=10, description="misfit of the map over that of the bias-only law, over trial_s")
    ] = 1.2
    worse_s: Annotated[Seconds, Field(description="s, worse for so long is taken back")] = 0.3
    disagreement: Annotated[tuple[Size, Size], Field(description="above this a tick is evidence, units of u")] = (
        *(0.3, 4.0),
    )
    proof_s: Annotated[Seconds, Field(description="s of evidence after which a version is proven")] = 0.5
    audition_s: Annotated[Seconds, Field(description="s of evidence after which a version may fly at all")] = 0.4
    agreement_s: Annotated[
        Seconds, Field(description="or s in which it says what the bias says, where none has failed before")
    ] = 1.0


def _squares(x: Vector3, y: Vector3) -> float:
    (a, b, c), (p, q, r) = x, y
    return (a - p) * (a - p) + (b - q) * (b - q) + (c - r) * (c - r)


class ChannelWatch:
    """One channel."""

    def __init__(
        self, config: WatchConfig, channel: int, gains: tuple[Array, Array], law: tuple[float, float], PB: Array
    ) -> None:
        """channel: 0, 1. gains: K_1 [3], K_2 [3]. law: lambda and gamma. PB: [6, 3] of the tracking term."""
        self._config = config
        self._k1, self._k2 = vector(gains[0].tolist()), vector(gains[1].tolist())
        self._rate, self._tracking, self._PB = *law, PB
        self._lag_s, self._apart2 = config.lag_s[channel], config.disagreement[channel] ** 2
        self._floors = config.misfit_floor[channel], config.error_floor[channel]
        self.reset()
        self.restart()

    def reset(self) -> None:
        """The bias to zero: on the ground."""
        self.d: Vector3 = REST
        """nu of the bias-only law, units of u."""
        self._sent: deque[tuple[Vector3, Vector3]] = deque()
        self._ticks, self._since_s = 0, 0.0

    def restart(self) -> None:
        """Another law flies, or another version: forget what was measured of the one before."""
        self._delta = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        self._misfits, self._errors = (0.0, 0.0, 0.0), (0.0, 0.0)
        self._worse_s = 0.0
        self.evidence_s = 0.0
        """Time in which the two laws disagreed."""
        self.agreed_s = 0.0
        """Time in which they did not."""
        self._trial = 0.0, 0.0
        """Mean squared misfits of the map and of the bias-only law, over trial_s of evidence."""
        self._gain = 0.0
        """Sum over it of the bias-only law's squared misfit less the map's."""

    def step(self, channel: ChannelState, Delta_hat: Array, now: Array, commanded: Array, level: int) -> None:
        """One tick.

        Parameters
        ----------
        Delta_hat: [3], the filtered residual.
        now, commanded: [3], nu of the law that learns, at the present and as it would be commanded.
        level: 0 the map flies, 1 the bias-only law, 2 none.
        """
        dt, (bx, by, bz), (rx, ry, rz) = channel.dt, self.d, channel.residual.tolist()
        share = 1.0 - exp(-self._rate * dt)
        bx, by, bz = bx + share * (rx - bx), by + share * (ry - by), bz + share * (rz - bz)
        if level == 1 and self._tracking > 0.0:
            px, py, pz = channel.model_error.dot(self._PB).tolist()
            pull = self._tracking * dt
            bx, by, bz = bx - pull * px, by - pull * py, bz - pull * pz
        self.d = bx, by, bz
        self._since_s += dt
        self._ticks += 1
        if self._ticks % STRIDE == 0:
            since, self._since_s = self._since_s, 0.0
            of_map = vector(now.tolist()), vector(commanded.tolist())
            self._compare(channel.model_error.tolist(), vector(Delta_hat.tolist()), of_map, level, since)

    def _compare(
        self, e: list[float], Delta_hat: Vector3, of_map: tuple[Vector3, Vector3], level: int, dt: float
    ) -> None:
        """Misfit and e of both laws, after `dt`."""
        now, commanded = of_map
        self._sent.append((commanded, self.d))
        if len(self._sent) * dt < self._lag_s:
            return
        then_map, then_bias = self._sent.popleft()
        fresh = min(dt / self._config.average_s, 1.0)
        m0, m1, m2 = self._misfits
        n0, n1, n2 = _squares(then_map, Delta_hat), _squares(then_bias, Delta_hat), _squares(REST, Delta_hat)
        self._misfits = m0 + fresh * (n0 - m0), m1 + fresh * (n1 - m1), m2 + fresh * (n2 - m2)
        flown, other = (now, self.d) if level == 0 else (self.d, now)
        mine, would = self._squared_errors(e, flown, other, dt)
        e0, e1 = self._errors
        of_map_e, of_bias_e = (mine, would) if level == 0 else (would, mine)
        self._errors = e0 + fresh * (of_map_e - e0), e1 + fresh * (of_bias_e - e1)
        if _squares(then_map, then_bias) > self._apart2:
            self.evidence_s += dt
            self._gain += dt * (n1 - n0)
            (t0, t1), fresh = self._trial, max(min(dt / self._config.trial_s, 1.0), dt / self.evidence_s)
            self._trial = t0 + fresh * (n0 - t0), t1 + fresh * (n1 - t1)
        else:
            self.agreed_s += dt
        self._worse_s = self._worse_s + dt if self.worse(level, level + 1) else max(self._worse_s - dt, 0.0)

    def _squared_errors(self, e: list[float], flown: Vector3, other: Vector3, dt: float) -> tuple[float, float]:
        """norm(K_1 e_1 + K_2 e_2)^2 as flown, and as it would be with the other law."""
        d1, d2 = self._delta
        mine = would = 0.0
        for i in (0, 1, 2):
            s, r = self._k1[i], self._k2[i]
            d2[i] += dt * (other[i] - flown[i] - s * d1[i] - r * d2[i])
            d1[i] += dt * d2[i]
            here = s * e[i] + r * e[3 + i]
            there = here + s * d1[i] + r * d2[i]
            mine += here * here
            would += there * there
        return mine, would

    def worse(self, one: int, other: int) -> str:
        """Why law `one` is worse than law `other` now; empty if it is not. 0 the map, 1 the bias-only law, 2 none."""
        if one >= 2:
            return ""
        margin, (misfit_floor, error_floor) = self._config.margin, self._floors
        if sqrt(self._misfits[one]) > margin * sqrt(self._misfits[other]) + misfit_floor:
            return "misfit"
        if one == 0 and self.loses(self._config.trial_s):
            return "misfit over its trial"
        if one == 0 and sqrt(self._errors[0]) > margin * sqrt(self._errors[1]) + error_floor:
            return "model error"
        return ""

    def loses(self, evidence_s: float) -> bool:
        """Whether so much evidence says that the map is worse than the bias."""
        of_map, of_bias = self._trial
        return self.evidence_s >= evidence_s and of_map > self._config.trial_margin**2 * of_bias

    @property
    def failed(self) -> bool:
        """Whether the law that flies has been worse than the next simpler one for too long."""
        return self._worse_s >= self._config.worse_s

    def stands(self, evidence_s: float) -> bool:
        """Whether so much evidence says that the map is no worse than the bias."""
        return self.evidence_s >= evidence_s and self._gain >= 0.0 and not self.worse(0, 1)

    @property
    def numbers(self) -> tuple[float, float, float, float]:
        """RMS misfit and weighted e, of the map and of the bias-only law, units of u."""
        return (*map(sqrt, self._misfits[:2]), *map(sqrt, self._errors[:2]))  # type: ignore[return-value]
