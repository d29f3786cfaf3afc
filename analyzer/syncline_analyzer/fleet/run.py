"""A run: the tasks of a plan on a cluster, whatever happens to its scheduler and its workers."""

import time
from asyncio import CancelledError
from collections.abc import Iterable, Iterator
from concurrent.futures import CancelledError as FutureCancelled
from contextlib import suppress
from dataclasses import field, replace
from typing import Protocol

import pyarrow as pa
from distributed import Client, Future, KilledWorker, as_completed

from syncline_analyzer.fleet.captures import FailureEntry, outcome_of
from syncline_analyzer.fleet.cluster import Connect, cluster
from syncline_analyzer.fleet.layout import failure_file
from syncline_analyzer.fleet.packing import pack_captures
from syncline_analyzer.fleet.plan import Order, Plan, plan
from syncline_analyzer.fleet.publish import remove_staging
from syncline_analyzer.fleet.task import Outcome, Task, analyze_task
from syncline_schemas.errors import SourceError, SynclineError, UsageError
from syncline_schemas.records import dataclass

PATIENCE_S = 300.0
"""So long a scheduler that is lost is waited for."""
_PAUSE_S = 0.5
_LOOK_S, _TICK_S = 1.0, 0.05
_PER_WORKER = 2
"""Tasks that a worker has at a time: one that it does, and the next one."""
_LOST = (CancelledError, FutureCancelled, OSError, TimeoutError)


class Watcher(Protocol):
    """Who wants to know how far a run is."""

    def planned(self, planned: Plan) -> None:
        """What is to be done is known."""

    def done(self, task: Task, outcome: Outcome) -> None:
        """A task is done."""

    def lost(self, reason: str) -> None:
        """The scheduler does not answer; it is waited for."""

    def packing(self, captures: int) -> None:
        """The tables of so many captures are packed now."""


@dataclass(slots=True)
class Summary:
    """What a run came to.

    Attributes:
        captures: recordings that were found.
        unchanged: captures that stand as they were.
        failed: recordings that failed, also earlier ones that were not tried again.
        no_captures: files that are none, though their ending is one of captures.
        frames: that were analyzed.
        verdicts: analyzed captures by verdict.
        cpu_s: of the workers over all tasks.
        peak_mb: most memory of a worker.
        failures: URL and reason of each failed one, the first hundred.
    """

    captures: int = 0
    analyzed: int = 0
    unchanged: int = 0
    failed: int = 0
    no_captures: int = 0
    frames: int = 0
    verdicts: dict[str, int] = field(default_factory=dict)
    cpu_s: float = 0.0
    peak_mb: float = 0.0
    wall_s: float = 0.0
    failures: list[tuple[str, str]] = field(default_factory=list)

    def take(self, task: Task, outcome: Outcome) -> None:
        """Count what came of a task."""
        self.cpu_s += outcome.cpu_s
        self.peak_mb = max(self.peak_mb, outcome.peak_mb or 0.0)
        match outcome.status:
            case "analyzed":
                self.analyzed += 1
                self.frames += outcome.frames
                self.verdicts[outcome.verdict] = self.verdicts.get(outcome.verdict, 0) + 1
            case "unchanged":
                self.unchanged += 1
            case "no capture":
                self.no_captures += 1
            case "failed" | "worker died":
                self.fail(task.recording.files[0].url, outcome.reason)

    def fail(self, url: str, reason: str) -> None:
        """Count a recording that failed."""
        self.failed += 1
        if len(self.failures) < _MAX_FAILURES:
            self.failures.append((url, reason))


_MAX_FAILURES = 100


def run(
    order: Order,
    watcher: Watcher,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    patience_s: float = PATIENCE_S,
) -> Summary:
    """Bring a data set up to date with its sources.

    Args:
        order: sources, data set and settings.
        scheduler: address of a Dask scheduler; by default processes of this machine.
        workers: so many of these; by default one for each processor.
        patience_s: how long a scheduler that is lost is waited for.

    Raises:
        UsageError: the address is none, or the workers cannot do it.
        SourceError: no scheduler answers.
    """
    begun_s = time.monotonic()
    order = replace(order, foreign=scheduler is not None)
    planned = plan(order)
    watcher.planned(planned)
    summary = _begun(planned)
    try:
        if planned.tasks:
            with cluster(scheduler, workers) as connect:
                for task, outcome in _outcomes(order, planned, connect, watcher, patience_s):
                    tell(task, outcome, planned)
                    summary.take(task, outcome)
                    watcher.done(task, outcome)
        # Questions only take longer without, and the next run tries again.
        with suppress(SynclineError, pa.ArrowException, OSError, ValueError):
            pack_captures(order.out, order.run, begun=watcher.packing)
    finally:
        remove_staging(order.out, order.run)
    summary.wall_s = time.monotonic() - begun_s
    return summary


def _begun(planned: Plan) -> Summary:
    """The summary before the first task."""
    summary = Summary(unchanged=len(planned.unchanged))
    summary.captures = len(planned.tasks) + len(planned.unchanged) + len(planned.still_failed)
    for failure in planned.still_failed:
        if failure.kind == "no capture":
            summary.no_captures += 1
        else:
            summary.fail(failure.files[0].url, failure.reason)
    return summary


def _outcomes(
    order: Order, planned: Plan, connect: Connect, watcher: Watcher, patience_s: float
) -> Iterator[tuple[Task, Outcome]]:
    """What comes of each task, in the order in which they are done."""
    left = {task.recording.key: task for task in planned.tasks}
    client = connect()
    try:
        while left:
            try:
                for task, outcome in _completed(client, left.values()):
                    del left[task.recording.key]
                    yield task, outcome
            except _SchedulerLost as lost:
                watcher.lost(str(lost))
                client = _again(client, connect, patience_s)
                for task, outcome in _done_meanwhile(plan(order), left):
                    yield task, outcome
    finally:
        client.close()


def _completed(client: Client, tasks: Iterable[Task]) -> Iterator[tuple[Task, Outcome]]:
    """What comes of tasks as long as the scheduler is there. Raises: _SchedulerLost."""
    waiting = list(tasks)[::-1]
    running: dict[Future[Outcome], Task] = {}
    completed = as_completed(loop=client.loop)
    try:
        while waiting or running:
            for _ in range(min(_room(client) - len(running), len(waiting))):
                task = waiting.pop()
                future = _submitted(client, task)
                running[future] = task
                completed.add(future)
            if _waited(client, completed):
                future = next(completed)
                task = running.pop(future)
                yield task, _outcome(future, task)
                future.release()
    except (KeyboardInterrupt, GeneratorExit):
        client.cancel(list(running), force=True)
        raise


def _room(client: Client) -> int:
    """Tasks that the workers may have at present, and one where there is none yet."""
    _check(client)
    try:
        return max(1, _PER_WORKER * len(client.nthreads()))
    except (*_LOST, RuntimeError, AttributeError) as error:
        # The two last ones are what a client says that was closed meanwhile.
        raise _SchedulerLost(str(error) or type(error).__name__) from error


def _submitted(client: Client, task: Task) -> Future[Outcome]:
    _check(client)
    try:
        return client.submit(analyze_task, task, pure=False)
    except (*_LOST, RuntimeError) as error:
        raise _SchedulerLost(str(error) or type(error).__name__) from error


def _check(client: Client) -> None:
    """Raises: _SchedulerLost; what is asked of a client without one is never answered."""
    if client.status != "running":
        raise _SchedulerLost("the connection is broken")


def _waited(client: Client, completed: as_completed) -> bool:
    """Wait for a task, at most so long that workers which came meanwhile get theirs."""
    until_s = time.monotonic() + _LOOK_S
    while not completed.has_ready() and time.monotonic() < until_s:
        _check(client)
        time.sleep(_TICK_S)
    return bool(completed.has_ready())


def _outcome(future: Future[Outcome], task: Task) -> Outcome:
    """What came of a task. Raises: _SchedulerLost; UsageError where workers lack Syncline."""
    try:
        outcome: Outcome = future.result()
    except KilledWorker:
        return Outcome(
            "worker died",
            "a worker died of it each time, perhaps for lack of memory"
            f" ({task.recording.size_bytes:,} bytes)",
        )
    except ImportError as error:
        raise UsageError(
            f"the workers cannot run Syncline: {error}; install syncline[fleet] there, the same"
            " version as here"
        ) from error
    except _LOST as error:
        raise _SchedulerLost(str(error) or type(error).__name__) from error
    except Exception as error:  # noqa: BLE001 - what Dask could not carry to or from a worker
        return Outcome("failed", f"internal error: {type(error).__name__}: {error}")
    return outcome


class _SchedulerLost(Exception):
    """The scheduler, or the connection to it, is gone, and with it what it knew of the tasks."""


def _again(client: Client, connect: Connect, patience_s: float) -> Client:
    """A new connection. Raises: SourceError when nobody answers for too long."""
    client.close()
    until_s = time.monotonic() + patience_s
    while True:
        try:
            return connect()
        except SourceError:
            if time.monotonic() >= until_s:
                raise
            time.sleep(_PAUSE_S)


def _done_meanwhile(now: Plan, left: dict[str, Task]) -> Iterator[tuple[Task, Outcome]]:
    """Those of the tasks whose captures stand by now; they are taken out of `left`.

    Of the others `left` then holds what has to be done now.
    """
    tasks = {task.recording.key: task for task in now.tasks}
    stands = {file.url: entry for entry in now.unchanged for file in entry.files}
    for key, task in list(left.items()):
        entry = stands.get(task.recording.files[0].url)
        if key in tasks:
            left[key] = tasks[key]
        else:
            del left[key]
            if entry is not None:
                yield task, replace(outcome_of("analyzed", entry), cpu_s=entry.values["cpu_s"])


def tell(task: Task, outcome: Outcome, planned: Plan) -> None:
    """Tell of a failure in the data set, and no longer of one that is over."""
    recording = task.recording
    urls = (file.url for file in recording.files)
    told = {planned.failures[url] for url in urls if url in planned.failures}
    failed = outcome.status not in ("analyzed", "unchanged")
    for key in sorted(told - {recording.key} if failed else told):
        task.out.remove(failure_file(key))
    if not failed:
        return
    kind = outcome.status if outcome.status != "failed" else "capture"
    failure = FailureEntry(
        recording.key,
        recording.machine,
        (*recording.files, *recording.copies),
        kind,
        outcome.reason,
        outcome.content_sha256,
        task.version,
    )
    task.out.write(failure_file(recording.key), failure.to_bytes())
