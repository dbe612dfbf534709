"""Runs a campaign's flights side by side and keeps their rows. The same loop feeds a local pool and a Dask cluster.

Both are a `concurrent.futures.Executor`. Few flights are under way at a time, so memory does not grow with the
campaign; a worker that dies costs its flight one more try, then that flight becomes a row with its error.
"""

import json
import multiprocessing
import time
from collections.abc import Callable, Iterable, Iterator, Set
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol

from configs.loader import ConfigError
from experiments.campaigns.campaign import CampaignConfig, FlightJob, unfold
from experiments.campaigns.fingerprint import fingerprint
from experiments.campaigns.flight_row import empty_row
from experiments.campaigns.flown import CAMPAIGN_FILE, About, is_campaign, read_about
from experiments.campaigns.provenance import here
from experiments.campaigns.store import CampaignStore
from experiments.campaigns.worker import FlightResult, fly_job, one_thread_each
from runtime.files import write_atomically

TRIES: Final = 2
QUEUED_PER_WORKER: Final = 2
"""Flights submitted for each worker: one in flight, one waiting."""
FLIGHTS_PER_PROCESS: Final = 200
"""Then a worker process is replaced by a fresh one, so that memory stays flat whatever a library may keep."""


class Workers(Protocol):
    """Where flights are flown."""

    count: int

    def open(self) -> Executor:
        """An executor; called again after it broke."""

    def close(self) -> None:
        """Ends everything that was opened."""


class LocalPool:
    """Processes of this machine, started afresh (spawn), one thread each."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._executor: ProcessPoolExecutor | None = None

    def open(self) -> Executor:
        """A new pool."""
        one_thread_each()
        context = multiprocessing.get_context("spawn")
        self._executor = ProcessPoolExecutor(
            self.count, context, initializer=_ignore_interrupt, max_tasks_per_child=FLIGHTS_PER_PROCESS
        )
        return self._executor

    def close(self) -> None:
        """Drops what waits and lets flights in the air finish."""
        if self._executor is not None:
            self._executor.shutdown(wait=True, cancel_futures=True)


def _ignore_interrupt() -> None:
    """Ctrl-C is for the parent, which ends the pool in order."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)


class DaskWorkers:
    """Workers of a Dask cluster, by its scheduler's address."""

    def __init__(self, address: str) -> None:
        """Raises ConfigError if distributed is not installed or nobody answers."""
        try:
            from distributed import Client
        except ImportError:
            raise ConfigError("--scheduler needs the extra `cluster`: pip install 'async-dmrac[cluster]'") from None
        try:
            self._client: Any = Client(address, timeout="10s", set_as_default=False)
        except (OSError, ValueError) as error:
            raise ConfigError(f"--scheduler {address}: no scheduler answers: {error}") from None
        self.count = max(sum(self._client.nthreads().values()), 1)

    def open(self) -> Executor:
        """The cluster as an executor. pure=False: the same job twice is two flights."""
        executor: Executor = self._client.get_executor(pure=False, retries=TRIES - 1)
        return executor

    def close(self) -> None:
        """Leaves the cluster as it was found."""
        self._client.close()


@dataclass
class Progress:
    """How far a campaign is."""

    total: int
    done: int = 0
    flown: int = 0
    lost: int = 0
    errors: int = 0
    started_s: float = field(default_factory=time.monotonic)

    @property
    def flights_per_s(self) -> float:
        """Since this run began."""
        return self.flown / max(time.monotonic() - self.started_s, 1e-9)


@dataclass
class CampaignRun:
    """A campaign in its folder."""

    campaign: CampaignConfig
    name: str
    folder: Path
    seeds: int | None = None
    """So many instead of the campaign's own number."""
    only: frozenset[str] | None = None
    """Keys of the flights to fly, with those that they start from; None: all."""

    def jobs(self) -> Iterator[FlightJob]:
        """Every flight to fly."""
        every = unfold(self.campaign, self.name, self.seeds)
        if self.only is None:
            return every
        jobs = list(every)
        wanted = self.only | {job.source for job in jobs if job.key in self.only}
        return (job for job in jobs if job.key in wanted)


def prepare_folder(run: CampaignRun, resume: bool) -> None:
    """Writes what the folder is about, or checks that it is about the same.

    Raises
    ------
    ConfigError
        If the folder holds flights and `resume` is not set, or holds those of another campaign or other settings.
    """
    tree = run.campaign.model_dump(mode="json")
    flown_on: tuple[str, ...] = ()
    if is_campaign(run.folder):
        if not resume:
            raise ConfigError(f"--out {run.folder}: holds a campaign already; add --resume, or choose another folder")
        before = read_about(run.folder)
        before.check_settings(run.campaign, f"--resume {run.folder}", "choose another folder")
        flown_on = before.flown_on
    about = About(
        name=run.name,
        fingerprint=fingerprint(run.campaign),
        seeds=run.seeds or run.campaign.seeds.count,
        flown_on=flown_on,
        campaign=tree,
    )
    _write(run.folder / CAMPAIGN_FILE, about.file_content())


def note_place(folder: Path) -> None:
    """Writes into a prepared folder that flights are flown here, with the versions of now."""
    about = read_about(folder)
    flown_on = tuple(dict.fromkeys([*about.flown_on, here()]))
    _write(folder / CAMPAIGN_FILE, about.model_copy(update={"flown_on": flown_on}).file_content())


def run_campaign(
    run: CampaignRun, store: CampaignStore, workers: Workers, report: Callable[[Progress], None]
) -> Progress:
    """Flies what is not in the store yet, and notes in a prepared folder where, if anything is missing.

    KeyboardInterrupt passes through; everything reported is kept.

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
    finally:
        workers.close()
    return progress


def _sources_to_refly(folder: Path, jobs: Iterable[FlightJob], done: Set[str]) -> set[str]:
    """Flights that are done, but not what they learnt is here, and others start from it.

    So it is where published rows were taken up: they come without it.
    """
    sources = {job.source for job in jobs if job.source and job.key not in done}
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
        """Under way when a worker died; any of them may have been the one that killed it."""
        self._tries: dict[str, int] = {}
        self._sources_under_way: set[str] = set()

    def fly(self, jobs: Iterable[FlightJob]) -> None:
        """Submits and takes in until nothing is left."""
        limit = self._workers.count * QUEUED_PER_WORKER
        for job in jobs:
            while len(self._under_way) >= limit or job.source in self._sources_under_way:
                self._take_in()
                self._clear_suspects()
            self._submit(job)
        self._land()
        self._clear_suspects()

    def _land(self) -> None:
        """Takes in until nothing is under way."""
        while self._under_way:
            self._take_in()

    def _clear_suspects(self) -> None:
        """Flies each suspect alone, so that no other flight pays for the one that kills its worker."""
        while self._suspects:
            self._land()
            self._submit(self._suspects.pop())
            self._land()

    def _submit(self, job: FlightJob) -> None:
        if job.source:
            path = experience_path(self._run.folder, job.source)
            if not path.exists():
                self._fail(job, f"the flight it starts from left no experience: {job.source}")
                return
            job = job.with_experience(path.read_bytes())
        if job.keep_experience:
            self._sources_under_way.add(job.key)
        self._tries[job.key] = self._tries.get(job.key, 0) + 1
        try:
            future = self._executor.submit(fly_job, job)
        except (RuntimeError, OSError):  # a pool that broke takes nothing more
            self._executor = self._workers.open()
            future = self._executor.submit(fly_job, job)
        self._under_way[future] = job

    def _take_in(self) -> None:
        done, _ = wait(self._under_way, return_when=FIRST_COMPLETED)
        for future in done:
            job = self._under_way.pop(future)
            try:
                result = future.result()
            except Exception as error:  # the worker died, or its answer did not come through
                self._again(job, f"the worker failed: {type(error).__name__}: {error}")
            else:
                self._keep(job, result)

    def _again(self, job: FlightJob, reason: str) -> None:
        if self._tries[job.key] < TRIES:
            self._suspects.append(job)
        else:
            self._fail(job, reason)

    def _keep(self, job: FlightJob, result: FlightResult) -> None:
        folder = self._run.folder
        if result.trace is not None:
            _write(folder / "traces" / f"{job.file_stem}.npz", result.trace)
            _write(folder / "traces" / f"{job.file_stem}.yaml", result.config.encode())
        if result.experience is not None:
            _write(experience_path(folder, job.key), result.experience)
        self._finish(job, result.row | {"command": job.command(folder)})

    def _fail(self, job: FlightJob, reason: str) -> None:
        about: dict[str, Any] = {
            "key": job.key,
            "campaign": job.campaign,
            "case": job.case,
            "controller": job.controller,
        }
        about |= {"seed": job.seed, "point": json.dumps(dict(job.point)), "command": job.command(self._run.folder)}
        self._finish(job, empty_row() | about | {"error": reason})

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
    """Where what a flight learnt is kept."""
    return folder / "experience" / f"{key.replace('/', '__')}.npz"


@contextmanager
def open_store(folder: Path) -> Iterator[CampaignStore]:
    """The folder's rows. Raises ConfigError if another campaign is writing there."""
    try:
        store = CampaignStore(folder)
    except BlockingIOError:
        raise ConfigError(f"--out {folder}: another campaign is writing there") from None
    try:
        yield store
    finally:
        store.close()
