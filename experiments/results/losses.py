"""Where DMRAC loses, said first: every error and the survival of its flights against every other controller's."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from experiments.results.campaign_data import CampaignData, Group
from experiments.results.statistics import INTERVAL_COUNT, Estimate, survives_less
from experiments.results.wording import counted, metric_name, show

OURS: Final = "dmrac"
DOUBTFUL_LISTED: Final = 8
"""So many sentences about what is not sure; what is, is told in full."""
ERRORS: Final = ("rmse_m", "rmse_rad", "worst_error_m", "recovery_s")
"""How the names of metrics end of which less is better."""


@dataclass(frozen=True)
class Comparison:
    """DMRAC and another controller, flown under the same conditions on the same seeds."""

    place: str
    """Case and point, in words."""
    rival: str
    worse: bool
    """Whether DMRAC is behind, by the median of the ratios or by the count of survivors."""
    sure: bool
    """Whether that is so at the 95 % level: beyond the ratio's interval, or by the paired test of survival."""
    before: str
    """What is compared, and DMRAC's own share where it is survival."""
    found: str
    """What the other one's is, or how often DMRAC's is the other one's."""

    @property
    def subject(self) -> str:
        """Place and quantity; comparisons that share it are told in one sentence."""
        return f"{self.place}: {self.before}"


def comparisons(data: CampaignData) -> Iterator[Comparison]:
    """Every comparison that the campaign's tables allow, survival first, then its metrics of error in their order."""
    metrics = [metric for metric in data.config.metrics if metric.endswith(ERRORS)]
    for ours in data.select(controller=OURS):
        place = ", ".join([data.label(ours.case), *(f"{name} {value}" for name, value in ours.point)])
        others = [group for group in _same_conditions(data, ours) if group.controller != OURS]
        for theirs in others:
            yield _survival(place, ours, theirs)
        for metric, theirs in itertools.product(metrics, others):
            ratio = ours.ratio(theirs, metric)
            if ratio.count:
                yield _error(place, metric, theirs.controller, ratio)


def _same_conditions(data: CampaignData, ours: Group) -> list[Group]:
    """Groups at the same point, and those of cases that are not swept."""
    cases = data.same_conditions(ours.case)
    return [group for case in cases for group in data.select(case) if group.point in (ours.point, ())]


def _survival(place: str, ours: Group, theirs: Group) -> Comparison:
    mine, other = ours.survival, theirs.survival
    sure = survives_less(ours.outcomes, theirs.outcomes)
    return Comparison(
        place,
        theirs.controller,
        worse=sure or other.value > mine.value,
        sure=sure,
        before=f"{OURS} survives {show(mine, percent=True)} of its flights,",
        found=f"{theirs.controller} {show(other, percent=True)}",
    )


def _error(place: str, metric: str, rival: str, ratio: Estimate) -> Comparison:
    few = f" ({counted(ratio.count, 'pair')})" if ratio.count < INTERVAL_COUNT else ""
    return Comparison(
        place,
        rival,
        worse=ratio.value > 1.0,
        sure=ratio.low > 1.0,
        before=metric_name(metric),
        found=f"{show(ratio, 2)}{few} times that of {rival}",
    )


def losses(compared: Sequence[Comparison], certain: bool) -> list[str]:
    """Where DMRAC is behind, a sentence for each place and quantity.

    certain: True for what is so at the 95 % level, False for what only the median or the count says.
    """
    behind = [one for one in compared if one.worse and one.sure is certain]
    subjects = dict.fromkeys(one.subject for one in behind)
    return [f"{subject} {', '.join(one.found for one in behind if one.subject == subject)}" for subject in subjects]


def first_paragraph(data: CampaignData, brief: bool = False) -> str:
    """What a report begins with. brief: what is not sure is counted, not listed."""
    seeds = sorted({row["seed"] for row in data.rows})
    about = f"{len(data.rows)} flights, seeds {seeds[0]} to {seeds[-1]}, the same for every controller."
    compared = list(comparisons(data))
    if not compared:
        return about
    sure = [one for one in compared if one.worse and one.sure]
    unsure = [one for one in compared if one.worse and not one.sure]
    share = f"{len(sure)} of {counted(len(compared), 'comparison')}"
    text = f"DMRAC loses nowhere at the 95 % level ({share})."
    if sure:
        text = f"**DMRAC loses here** ({share}): {'; '.join(losses(compared, certain=True))}."
    if len(seeds) < INTERVAL_COUNT:
        text = f"Only {counted(len(seeds), 'seed')} {'were' if len(seeds) > 1 else 'was'} flown, too few for intervals."
    if unsure:
        places = f"in {len(unsure)}" if brief else _some(losses(compared, certain=False))
        text += f" Behind by the median or the count only: {places}."
    return f"{text} {about}"


def _some(sentences: Sequence[str]) -> str:
    more = len(sentences) - DOUBTFUL_LISTED
    return "; ".join(sentences[:DOUBTFUL_LISTED]) + (f"; and {more} more, see the tables" if more > 0 else "")
