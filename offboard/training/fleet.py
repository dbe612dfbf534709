"""The vehicles of one trainer: they share the inner layers, and one round trains for all of them.

Each vehicle keeps its own samples, last layer, gate and versions; what the fleet has in common are the inner layers and
the mean of the last layers (offboard.training.round). A round takes the jobs of all vehicles that wait for one. The
samples of the others are those of their last job, so that a vehicle that has landed still teaches.
"""

from collections import deque
from dataclasses import replace
from typing import Final

import numpy as np

from offboard.training.job import TrainerState, TrainingJob, TrainingResult
from offboard.training.network import InputPlan, NetworkState, feature_set
from offboard.training.prior import with_contest
from protocol.feature_set import FeatureSet

MATURE_ROUNDS: Final = 20
"""Rounds after which a vehicle that has not flown yet gets the inner layers."""


class FleetJob:
    """A vehicle's job in a fleet. The first one that is run trains for all that wait."""

    def __init__(self, fleet: "Fleet", job: TrainingJob) -> None:
        self._fleet = fleet
        self.job: Final = job
        self.result: TrainingResult | None = None
        self.error: Exception | None = None

    def run(self) -> TrainingResult:
        """Return the result of this vehicle. Raises what its training raised."""
        if self.result is None and self.error is None:
            self._fleet.train()
        if self.result is None:
            raise self.error or RuntimeError("a job of a fleet was run twice")
        return self.result


class Fleet:
    """The shared networks and the jobs of all vehicles. Jobs may be entered in another thread than they are run in."""

    def __init__(self) -> None:
        self._waiting: deque[FleetJob] = deque()
        self._known: dict[int, TrainingJob] = {}
        """The last job of each vehicle."""
        self._last_layers: dict[int, NetworkState] = {}
        """The networks of each vehicle after its last round; their last layers count."""
        self._state: TrainerState | None = None

    def enter(self, job: TrainingJob) -> FleetJob:
        """Let a vehicle wait for the next round."""
        entered = FleetJob(self, job)
        self._waiting.append(entered)
        return entered

    def start(self) -> FeatureSet | None:
        """What a vehicle that has not flown yet starts with: the inner layers with theta = 0.

        None before they have been trained for a while. What the others' last layers are worth here is not known yet.
        """
        state = self._state
        if state is None or state.rounds < MATURE_ROUNDS:
            return None
        job = next(iter(self._known.values()))
        own = next(iter(self._last_layers.values()))
        blank = replace(own, last_layer=np.zeros_like(own.last_layer), last_bias=np.zeros_like(own.last_bias))
        return feature_set(blank, InputPlan.of(job.network_config), 1, 0, job.samples_seen)

    def train(self) -> None:
        """Run one round for all vehicles that wait. Where it fails, each is trained alone; one that fails leaves."""
        waiting = [self._waiting.popleft() for _ in range(len(self._waiting))]
        self._known |= {one.job.vehicle: one.job for one in waiting}
        try:
            results = self._train_known()
        except Exception:  # of any kind: the samples of one vehicle must not end the training of the others
            self._state = None
            for one in waiting:
                self._train_alone(one)
            return
        for one in waiting:
            one.result = with_contest(one.job, results[one.job.vehicle])

    def _train_known(self) -> dict[int, TrainingResult]:
        """Run a round on the samples of every vehicle."""
        from offboard.training.round import train_together, with_last_layers

        jobs = list(self._known.values())
        state = jobs[0].state
        if len(jobs) > 1:
            shared = state if self._state is None else self._state
            own = [self._last_layers.get(job.vehicle, job.state.network) for job in jobs]
            state = replace(shared, network=with_last_layers(shared.network, own))
        results, self._state = train_together(jobs, state)
        if len(jobs) == 1:
            results = [replace(results[0], state=self._state)]
        self._last_layers = {job.vehicle: one.state.network for job, one in zip(jobs, results, strict=True)}
        return dict(zip(self._known, results, strict=True))

    def _train_alone(self, entered: FleetJob) -> None:
        try:
            entered.result = entered.job.run()
        except Exception as error:  # raised again where its own vehicle asks for the result
            entered.error = error
            self._known.pop(entered.job.vehicle)
