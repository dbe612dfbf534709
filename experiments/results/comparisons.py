"""Compares DMRAC with every other controller: survival and each error metric, with a verdict for each comparison."""

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

from experiments.results.campaign_data import OURS, CampaignData, Group
from experiments.results.statistics import INTERVAL_COUNT, SIGNIFICANT, holm, sign_test
from experiments.results.tables import Table
from experiments.results.wording import counted, metric_name, show

ERRORS: Final = ("rmse_m", "rmse_rad", "worst_error_m", "recovery_s")
"""Endings of the metrics for which less is better."""
BETTER: Final = "better"
WORSE: Final = "worse"
OPEN: Final = "no significant difference"
LOSSES_HEADER: Final = ("condition", "quantity", "significantly worse than", "worse, not significant")


@dataclass(frozen=True)
class Comparison:
    """DMRAC against one other controller under the same conditions, on the same seeds."""

    campaign: str
    condition: str
    """Case and point of the sweep, in words."""
    quantity: str
    rival: str
    behind: bool
    """Whether DMRAC has the worse median or the smaller number of survivors, significant or not."""
    p_value: float
    """Sign test, two-sided, not corrected for the number of comparisons."""
    found: str
    """The other controller's survival, or the median ratio of the errors, DMRAC's to the other's."""
    verdict: str = OPEN
    """BETTER, WORSE or OPEN; `judged` sets it."""


def comparisons(data: CampaignData) -> Iterator[Comparison]:
    """Yield every comparison that the campaign's tables allow: survival first, then the error metrics in order."""
    metrics = [metric for metric in data.config.metrics if metric.endswith(ERRORS)]
    for ours in data.select(controller=OURS):
        rivals = data.rivals(ours)
        for theirs in rivals:
            yield _survival(data, ours, theirs)
        for metric, theirs in itertools.product(metrics, rivals):
            ratio = ours.ratio(theirs, metric)
            if ratio.count:
                few = f" ({counted(ratio.count, 'pair')})" if ratio.count < INTERVAL_COUNT else ""
                _, _, p_value = sign_test(ours.values(metric), theirs.values(metric))
                behind, found = ratio.value > 1.0, f"{show(ratio, 2)}{few}"
                yield _comparison(data, ours, theirs, metric_name(metric), behind, p_value, found)


def _survival(data: CampaignData, ours: Group, theirs: Group) -> Comparison:
    less, more, p_value = sign_test(ours.outcomes, theirs.outcomes)
    behind = less > more if less != more else theirs.survival.value > ours.survival.value
    quantity = f"survival, {OURS} {show(ours.survival, percent=True)}"
    return _comparison(data, ours, theirs, quantity, behind, p_value, show(theirs.survival, percent=True))


def _comparison(
    data: CampaignData, ours: Group, theirs: Group, quantity: str, behind: bool, p_value: float, found: str
) -> Comparison:
    return Comparison(data.title, data.condition(ours), quantity, theirs.controller, behind, p_value, found)


def judged(compared: Sequence[Comparison]) -> list[Comparison]:
    """Return the comparisons with their verdicts, at the 5 % level after Holm's correction for all of them."""
    corrected = holm([one.p_value for one in compared])
    verdicts = [
        (WORSE if one.behind else BETTER) if p < SIGNIFICANT else OPEN
        for one, p in zip(compared, corrected, strict=True)
    ]
    return [replace(one, verdict=verdict) for one, verdict in zip(compared, verdicts, strict=True)]


def verdict_counts(compared: Sequence[Comparison]) -> tuple[int, int, int]:
    """Return how often DMRAC is better, is worse, and does not differ significantly."""
    found = Counter(one.verdict for one in compared)
    return found[BETTER], found[WORSE], found[OPEN]


def losses(compared: Sequence[Comparison]) -> Table | None:
    """Return the table of all comparisons in which DMRAC is behind; None if there are none."""
    behind: dict[tuple[str, str], tuple[list[str], list[str]]] = {}
    for one in compared:
        if one.behind:
            significant, open_ = behind.setdefault((one.condition, one.quantity), ([], []))
            (significant if one.verdict == WORSE else open_).append(f"{one.rival} {one.found}")
    rows = tuple((*subject, *("; ".join(cell) or "–" for cell in cells)) for subject, cells in behind.items())
    caption = (
        "Where DMRAC is worse: survival of the other controller, or median of DMRAC's error / its error, paired by seed"
    )
    return Table(caption, LOSSES_HEADER, rows) if rows else None


def summary(data: CampaignData, compared: Sequence[Comparison]) -> str:
    """Return the opening sentences of a report: flights, seeds, and the number of each verdict."""
    seeds = sorted({row["seed"] for row in data.rows})
    text = f"{len(data.rows)} flights, seeds {seeds[0]} to {seeds[-1]}, the same for every controller."
    if not compared:
        return text
    better, worse, open_ = verdict_counts(compared)
    text += f" {counted(len(compared), 'comparison')}: DMRAC is better in {better}, **worse in {worse}**, "
    text += f"and does not differ significantly in {open_}."
    if len(seeds) < INTERVAL_COUNT:
        text += f" {counted(len(seeds), 'seed')} {'are' if len(seeds) > 1 else 'is'} too few for intervals."
    return text
