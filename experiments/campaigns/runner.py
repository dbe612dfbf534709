"""Runs a campaign's flights side by side and stores their rows, with a local pool or a Dask cluster.

Only a few flights are submitted at a time, so memory does not grow with the campaign. If a worker dies, its flight is
tried once more; if that fails too, the flight becomes a row with its error.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Set
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from configs.loader import ConfigError
from experiments.campaigns.campaign import CampaignConfig
from experiments.campaigns.fingerprint import fingerprint
from experiments.campaigns.flight_jobs import FlightJob, memory_path, unfold
from experiments.campaigns.flown import CAMPAIGN_FILE, About, is_campaign, read_about
from experiments.campaigns.provenance import here
from experiments.campaigns.store import CampaignStore
from experiments.campaigns.worker import FlightResult, fly_job
from experiments.campaigns.worker_pools import TRIES, Workers
from onboard.cores import NUMPY, check_core
from runtime.files import write_atomically

ALIVE_EVERY_S: Final = 2.0
QUEUED_PER_WORKER: Final = 2
"""Flights submitted for each worker: one in flight, one waiting."""


@dataclass
class Progress:
    """Progress of a campaign."""

    total: int
    done: int = 0
    flown: int = 0
    lost: int = 0
    errors: int = 0
    started_s: float = field(default_factory=time.monotonic)

    @property
    def flights_per_s(self) -> float:
        """Mean rate since this run began."""
        return self.flown / max(time.monotonic() - self.started_s, 1e-9)


@dataclass
class CampaignRun:
    """A campaign and its folder."""

    campaign: CampaignConfig
    name: str
    folder: Path
    seeds: int | None = None
    """Number of seeds; None: the campaign's."""
    only: frozenset[str] | None = None
    """Keys of the flights to fly, in addition to those they start from; None: all."""
    core: str = NUMPY
    """The onboard core of all flights, one of onboard.cores.CORES."""

    def jobs(self) -> Iterator[FlightJob]:
        """Yield every flight to fly."""
        every = unfold(self.campaign, self.name, self.seeds, self.core)
        if self.only is None:
            return every
        jobs = list(every)
        wanted = self.only | {source for job in jobs if job.key in self.only for source in job.sources}
        return (job for job in jobs if job.key in wanted)


def prepare_folder(run: CampaignRun, resume: bool) -> None:
    """Write the campaign file into the folder, or check that the folder's flights have the same settings.

    Raises
    ------
    ConfigError
        If the folder holds a campaign and `resume` is not set, or if its settings or core differ, or if the core cannot
        fly one of the controllers.
    """
    check_controllers(run)
    tree = run.campaign.model_dump(mode="json")
    flown_on: tuple[str, ...] = ()
    if is_campaign(run.folder):
        if not resume:
            raise ConfigError(f"--out {run.folder}: holds a campaign already; add --resume, or choose another folder")
        before = read_about(run.folder)
        if before.core != run.core:
            raise ConfigError(
                f"--core {run.core}: the flights in {run.folder} were flown with --core {before.core}; "
                "choose another folder"
            )
        before.check_settings(run.campaign, f"--resume {run.folder}", "choose another folder")
        flown_on = before.flown_on
    about = About(
        name=run.name,
        fingerprint=fingerprint(run.campaign, run.core),
        seeds=run.seeds or run.campaign.seeds.count,
        core=run.core,
        flown_on=flown_on,
        campaign=tree,
    )
    _write(run.folder / CAMPAIGN_FILE, about.file_content())


def check_controllers(run: CampaignRun) -> None:
    """Raises ConfigError if the core of the flights is not numpy's and cannot be built with one of the controllers.

    A flight whose settings are wrong is left to its row.
    """
    if run.core == NUMPY:
        return
    checked: set[str] = set()
    for job in unfold(run.campaign, run.name, seeds=1):
        if job.controller in checked:
            continue
        try:
            config = job.configuration()
        except ConfigError:
            continue
        check_core(run.core, config.onboard)
        checked.add(job.controller)


def note_place(folder: Path) -> None:
    """Record this machine and its versions in the campaign file of a prepared folder."""
    about = read_about(folder)
    flown_on = tuple(dict.fromkeys([*about.flown_on, here()]))
    _write(folder / CAMPAIGN_FILE, about.model_copy(update={"flown_on": flown_on}).file_content())


def run_campaign(
    run: CampaignRun, store: CampaignStore, workers: Workers, report: Callable[[Progress], None]
) -> Progress:
    """Fly the flights that are not in the store; if there are any, record the machine in a prepared folder.

    KeyboardInterrupt is passed on; reported flights are stored, and those in the air are given up.

    Parameters
    ----------
    report: called after every flight.
    """
    jobs = list(run.jobs())
    done = store.done - _sources_to_refly(run.folder, jobs, store.done)
    missing = [job for job in jobs if job.key not in done]
    progress = Progress(len(jobs), done=len(jobs) - len(missing))
    report(progress)
    if missing and is_campaign(run.folder):
        note_place(run.folder)
    try:
        loop = _Loop(run, store, workers, progress, report)
        loop.fly(missing)
    except KeyboardInterrupt:
        workers.abandon()
        raise
    finally:
        workers.close()
    return progress


def _sources_to_refly(folder: Path, jobs: Iterable[FlightJob], done: Set[str]) -> set[str]:
    """Return flights that are done but whose experience is missing, although other flights start from it.

    Published rows come without the experience.
    """
    sources = {source for job in jobs if job.key not in done for source in job.sources}
    return {key for key in sources & done if not experience_path(folder, key).exists()}


class _Loop:
    """Keeps the workers busy until all jobs are done."""

    def __init__(
        self,
        run: CampaignRun,
        store: CampaignStore,
        workers: Workers,
        progress: Progress,
        report: Callable[[Progress], None],
    ) -> None:
        self._run, self._store, self._workers = run, store, workers
        self._progress, self._report = progress, report
        self._executor = workers.open()
        self._under_way: dict[Future[FlightResult], FlightJob] = {}
        self._suspects: list[FlightJob] = []
        """Jobs that were under way when a worker died; any of them may have killed it."""
        self._tries: dict[str, int] = {}
        self._sources_under_way: set[str] = set()

    def fly(self, jobs: Iterable[FlightJob]) -> None:
        """Submit jobs and receive results until all are done."""
        limit = self._workers.count * QUEUED_PER_WORKER
        for job in jobs:
            while len(self._under_way) >= limit or self._sources_under_way.intersection(job.sources):
                self._receive()
                self._clear_suspects()
            self._submit(job)
        self._land()
        self._clear_suspects()

    def _land(self) -> None:
        """Receive results until no job is under way."""
        while self._under_way:
            self._receive()

    def _clear_suspects(self) -> None:
        """Fly each suspect alone, so that the one that kills its worker affects no other flight."""
        while self._suspects:
            self._land()
            self._submit(self._suspects.pop())
            self._land()

    def _submit(self, job: FlightJob) -> None:
        paths = [experience_path(self._run.folder, source) for source in job.sources]
        for source, path in zip(job.sources, paths, strict=True):
            if not path.exists():
                self._fail(job, f"the flight it starts from left no experience: {source}")
                return
        if job.memory:
            job = replace(job, lessons=tuple(path.read_bytes() for path in paths))
        elif paths:
            job = replace(job, experience=paths[0].read_bytes())
        if job.keep_experience:
            self._sources_under_way.add(job.key)
        self._tries[job.key] = self._tries.get(job.key, 0) + 1
        try:
            future = self._executor.submit(fly_job, job)
        except (RuntimeError, OSError):  # a broken pool accepts no more jobs
            self._executor = self._workers.open()
            future = self._executor.submit(fly_job, job)
        self._under_way[future] = job

    def _receive(self) -> None:
        done: set[Future[FlightResult]] = set()
        while not done:
            done, _ = wait(self._under_way, ALIVE_EVERY_S, return_when=FIRST_COMPLETED)
            if not done:
                self._workers.require_alive()
        for future in done:
            job = self._under_way.pop(future)
            try:
                result = future.result()
            except Exception as error:  # the worker died, or its answer was lost
                self._workers.require_alive()
                self._again(job, f"the worker failed: {type(error).__name__}: {error}")
            else:
                self._store_result(job, result)

    def _again(self, job: FlightJob, reason: str) -> None:
        if self._tries[job.key] < TRIES:
            self._suspects.append(job)
        else:
            self._fail(job, reason)

    def _store_result(self, job: FlightJob, result: FlightResult) -> None:
        folder = self._run.folder
        if result.trace is not None:
            _write(folder / "traces" / f"{job.file_stem}.npz", result.trace)
            _write(folder / "traces" / f"{job.file_stem}.yaml", result.config.encode())
        if result.experience is not None:
            _write(experience_path(folder, job.key), result.experience)
        if result.memory is not None:
            _write(memory_path(folder, job.memory), result.memory)
        self._finish(job, result.row | {"command": job.command(folder)})

    def _fail(self, job: FlightJob, reason: str) -> None:
        self._finish(job, job.empty_row(self._run.folder) | {"error": reason})

    def _finish(self, job: FlightJob, row: dict[str, Any]) -> None:
        self._store.append(row)
        self._sources_under_way.discard(job.key)
        self._tries.pop(job.key, None)
        progress = self._progress
        progress.done += 1
        progress.flown += 1
        progress.errors += bool(row["error"])
        progress.lost += not row["survived"] and not row["error"]
        self._report(progress)


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content)


def experience_path(folder: Path, key: str) -> Path:
    """Return the file with what a flight learnt."""
    return folder / "experience" / f"{key.replace('/', '__')}.npz"


@contextmanager
def open_store(folder: Path) -> Iterator[CampaignStore]:
    """Open the rows of a folder. Raises ConfigError if another process has it open."""
    try:
        store = CampaignStore(folder)
    except BlockingIOError:
        raise ConfigError(f"--out {folder}: another campaign is writing there") from None
    try:
        yield store
    finally:
        store.close()
