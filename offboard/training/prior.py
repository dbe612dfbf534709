"""A round of training that starts from a prior: what earlier flights taught (offboard.memory).

Two entrants per channel: the prior's inner layers with their last layer refitted towards theta, and the networks that
the round has trained on this flight, from the start that they would have without a prior: a prior of another condition
may be a bad one. In the first round, held-out samples say who leads. Later, each round's entrants are tried on the
samples that arrive after them (`Contest`). Whoever leads there is the round's candidate, which the gate then judges
like any other.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from offboard.data.buffer import TRAINING, VALIDATION, SampleTable
from offboard.memory.memory import INDEPENDENT_S, Prior, posterior_mean
from offboard.training.evidence import as_sent, evidence_of, held_out
from offboard.training.mixture import draw_probability, of_split
from offboard.training.network import InputPlan, feature_set, phi
from protocol.feature_set import ChannelFeatures, FeatureSet
from protocol.signals import CHANNELS

if TYPE_CHECKING:
    from offboard.training.job import TrainingJob, TrainingResult

EVIDENCE_HALF_LIFE_S: Final = 4.0
EVIDENCE_MINIMUM_S: Final = 2.0
"""s of newer samples, before they may give the lead to the networks trained on this flight."""
LEAD: Final = 0.03
"""Share by which an entrant's errors must be smaller to take the lead of a channel."""


@dataclass(frozen=True, slots=True, eq=False)
class Contest:
    """Two entrants and how they have predicted samples that were not there yet when they were made."""

    made_ns: int = 0
    """Time of the newest sample known when the entrants were made."""
    refitted: FeatureSet | None = None
    trained: FeatureSet | None = None
    errors: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    """Sums of squared errors, fading: of refitted and trained, for each channel."""
    seconds: float = 0.0
    """s of samples in these sums, fading with them."""
    trained_leads: tuple[bool, bool] = (False, False)
    """Whether the networks trained on this flight lead, for each channel."""

    def continued(self, samples: SampleTable) -> "Contest":
        """The contest with the samples that are newer than its entrants.

        Errors count about their mean over these samples: the law on board removes a constant error at once.
        """
        new = samples.take(samples.time_ns > self.made_ns)
        if self.refitted is None or self.trained is None or new.rows < 2:
            return self
        elapsed_s = float(new.time_ns.max() - new.time_ns.min()) * 1e-9
        fade = 0.5 ** (elapsed_s / EVIDENCE_HALF_LIFE_S)
        now = [_scatter(entrant, new) for entrant in (self.refitted, self.trained)]
        sums = fade * np.array(self.errors) + np.array(now)
        (a, b), (c, d) = sums.tolist()
        seconds = fade * self.seconds + elapsed_s
        leads = self._lead(0, a, c, seconds), self._lead(1, b, d, seconds)
        return replace(self, errors=((a, b), (c, d)), seconds=seconds, trained_leads=leads)

    def opened(self, refitted: FeatureSet, trained: FeatureSet, held_out: SampleTable) -> "Contest":
        """The contest of the first round: held-out samples say who leads."""
        (a, b), (c, d) = (_scatter(entrant, held_out) for entrant in (refitted, trained))
        return replace(self, trained_leads=(c < a, d < b))

    def _lead(self, channel: int, refitted: float, trained: float, seconds: float) -> bool:
        """Whether the trained networks lead with these errors: the lead changes only by a clear margin."""
        if self.trained_leads[channel]:
            return refitted >= (1.0 - LEAD) * trained
        return seconds >= EVIDENCE_MINIMUM_S and trained < (1.0 - LEAD) * refitted


NO_CONTEST: Final = Contest()


def with_contest(job: "TrainingJob", result: "TrainingResult") -> "TrainingResult":
    """The result of a round, with the candidate that leads where the flight started from a prior."""
    prior = job.prior
    if prior is None:
        return result
    known = job.buffer.joined(job.newest)
    refitted, trained = as_sent(job, refit(job, prior)), result.candidate
    if job.contest.refitted is None:
        contest = job.contest.opened(refitted, trained, held_out(job, VALIDATION))
    else:
        contest = job.contest.continued(job.newest)
    leading = [_leading(contest, at, refitted, trained) for at in range(len(CHANNELS))]
    candidate = _without_losses(job, replace(trained, position=leading[0], attitude=leading[1]))
    contest = replace(contest, made_ns=int(known.time_ns.max(initial=0)), refitted=refitted, trained=trained)
    evidence = evidence_of(job, candidate, result.evidence.numpy_difference)
    diverged = not np.isfinite(result.evidence.candidate_errors).all()
    return result if diverged else replace(result, candidate=candidate, evidence=evidence, contest=contest)


def _without_losses(job: "TrainingJob", candidate: FeatureSet) -> FeatureSet:
    """The candidate, but each channel that the flying version explains as well, on held-out samples, as it flies.

    Otherwise the gate would keep back what one channel gains for what the other one may lose.
    """
    if job.flying is None:
        return candidate
    evidence, channels = evidence_of(job, candidate, 0.0), list[ChannelFeatures | None]()
    for at, (new, flying) in enumerate(zip(candidate.by_channel, job.flying.by_channel, strict=True)):
        gains = evidence.flying_errors[:, at] - evidence.candidate_errors[:, at]
        gains = gains[np.isfinite(gains)]
        keeps = flying is not None and not (gains.size and gains.mean() > 0.0)
        channels.append(flying if keeps else new)
    return replace(candidate, position=channels[0], attitude=channels[1])


def _leading(contest: Contest, at: int, refitted: FeatureSet, trained: FeatureSet) -> ChannelFeatures | None:
    entrant = trained if contest.trained_leads[at] else refitted
    return entrant.by_channel[at]


def refit(job: "TrainingJob", prior: Prior) -> FeatureSet:
    """The prior's inner layers with the posterior mean of the last layer, given the samples of this flight.

    The newest samples and the buffer have the shares that a mini-batch gives them: the last layer follows a fault.
    """
    plan = InputPlan.of(job.network_config)
    parent = 0 if job.flying is None else job.flying.version
    start = feature_set(prior.network, plan, job.version, parent, job.samples_seen)
    newest, buffer = of_split(job.newest, TRAINING), of_split(job.buffer, TRAINING)
    samples = newest.joined(buffer)
    if samples.rows == 0:
        return start
    # Their sum is the number of independent labels.
    independent = np.unique(samples.time_ns // round(INDEPENDENT_S * 1e9)).size
    weights = independent * draw_probability(job.buffer_config, newest, buffer)
    fitted: list[ChannelFeatures | None] = [None, None]
    for row, (at, channel) in enumerate(zip(plan.channels, start.channels, strict=True)):
        known = ~np.isnan(samples.labels[:, at, 0])
        root = np.sqrt(weights[known])[:, None]
        Phi = phi(channel, samples.signals[known]) * root
        Delta = samples.labels[known, at].astype(np.float64) * root
        W = posterior_mean(Phi, Delta, channel.last_layer, float(prior.variance[row] / prior.noise[row]))
        fitted[at] = replace(channel, last_layer=W)
    return replace(start, position=fitted[0], attitude=fitted[1])


def _scatter(features: FeatureSet, samples: SampleTable) -> list[float]:
    """Sum of squared errors about their mean, of both channels; 0 for a channel without features."""
    found = [0.0, 0.0]
    for at, channel in enumerate(features.by_channel):
        known = ~np.isnan(samples.labels[:, at, 0])
        if channel is not None and known.any():
            errors = samples.labels[known, at] - phi(channel, samples.signals[known]) @ channel.last_layer
            found[at] = float(np.square(errors - errors.mean(axis=0)).sum())
    return found
