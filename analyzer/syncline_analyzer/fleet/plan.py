"""What is to be done: the recordings of the sources that are new or changed."""

import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from typing import Any

from syncline_analyzer.fleet.captures import CaptureEntry, FailureEntry
from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.gathering import recordings_of
from syncline_analyzer.fleet.layout import Partition
from syncline_analyzer.fleet.machine import MachineRule
from syncline_analyzer.fleet.recording import File, Recording
from syncline_analyzer.fleet.source import Found
from syncline_analyzer.fleet.storage import Storage
from syncline_analyzer.fleet.task import Settings, Task
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class Plan:
    """The tasks of a run, the largest first, and what needs none.

    Attributes:
        unchanged: captures that stand as they would come out.
        still_failed: failures that would come out the same.
        failures: keys of the failures that are told of, by the URLs of their files.
    """

    tasks: Sequence[Task]
    unchanged: Sequence[CaptureEntry]
    still_failed: Sequence[FailureEntry]
    failures: Mapping[str, str]

    @property
    def size_bytes(self) -> int:
        """Of all recordings to be analyzed."""
        return sum(task.recording.size_bytes for task in self.tasks)


@dataclass(frozen=True)
class Order:
    """What a user wants.

    Attributes:
        found: files that may be captures.
        out: the data set.
        options: of the file systems of the files' URLs.
        retry_failed: analyze again what failed, though nothing changed.
        foreign: whether the workers may have another Syncline than this one.
    """

    found: Sequence[Found]
    out: Storage
    rule: MachineRule = field(default_factory=MachineRule)
    settings: Settings = field(default_factory=Settings)
    options: Mapping[str, Any] = field(default_factory=dict)
    retry_failed: bool = False
    run: str = field(default_factory=lambda: uuid.uuid4().hex)
    foreign: bool = False


def plan(order: Order) -> Plan:
    """Compare what is there with what stands in the data set."""
    data = Dataset.of(order.out)
    known = _Known(data)
    recordings = recordings_of(order.found, order.rule, known.files, order.options)
    tasks, unchanged, still_failed = [], [], []
    for recording in recordings:
        version = order.settings.version(recording.machine)
        earlier = known.of(recording)
        same = next((each for each in earlier if _stands(each, recording, version, order)), None)
        failure = known.failures.get(recording.key)
        if same is not None:
            unchanged.append(same)
        elif failure is not None and _holds(failure, recording, version, order):
            still_failed.append(failure)
        else:
            places = tuple(each.partition for each in earlier)
            tasks.append(_task(recording, version, places, order))
    tasks.sort(key=lambda task: (-task.recording.size_bytes, task.recording.key))
    failures = {file.url: each.key for each in known.failures.values() for file in each.files}
    return Plan(tasks, unchanged, still_failed, failures)


class _Known:
    """What a data set knows, by what it is asked by."""

    def __init__(self, data: Dataset) -> None:
        self.failures = {failure.key: failure for failure in data.failures}
        self.files: dict[str, File] = {}
        self._by_id: dict[str, list[CaptureEntry]] = {}
        self._by_url: dict[str, list[CaptureEntry]] = {}
        self._take(file for failure in data.failures for file in failure.files)
        for entry in data.captures:
            self._by_id.setdefault(entry.partition.capture_id, []).append(entry)
            self._take((*entry.files, *entry.copies))
            for url in entry.urls:
                self._by_url.setdefault(url, []).append(entry)

    def _take(self, files: Iterable[File]) -> None:
        self.files.update((file.url, file) for file in files)

    def of(self, recording: Recording) -> list[CaptureEntry]:
        """Captures that stand for a recording, or for one of its files."""
        found = list(self._by_id.get(recording.capture_id, ()))
        for file in (*recording.files, *recording.copies):
            found += (each for each in self._by_url.get(file.url, ()) if each not in found)
        return found


def _stands(entry: CaptureEntry, recording: Recording, version: str, order: Order) -> bool:
    """Whether a capture would come out the same; segments that are gone leave it as it is.

    A copy that came since is of no use to a capture that is whole.
    """
    needed = recording.files
    if entry.values["damage"]:
        needed += recording.copies
    return (
        entry.version == version
        and entry.partition.machine == recording.machine
        and recording.capture_id in ("", entry.partition.capture_id)
        and {file.stamp for file in needed} <= entry.stamps
        and entry.has(order.settings.extras)
    )


def _holds(failure: FailureEntry, recording: Recording, version: str, order: Order) -> bool:
    stamps = {file.stamp for file in failure.files}
    files = (*recording.files, *recording.copies)
    return (
        not order.retry_failed
        and failure.version == version
        and failure.machine == recording.machine
        and {file.stamp for file in files} == stamps
    )


def _task(recording: Recording, version: str, earlier: tuple[Partition, ...], order: Order) -> Task:
    return Task(
        recording,
        version,
        order.settings,
        order.out,
        order.options,
        earlier,
        order.run,
        order.foreign,
    )
