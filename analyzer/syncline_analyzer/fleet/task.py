"""What a worker is asked to do with one recording, and what it answers.

The scheduler loads this module too: nothing heavy is imported here.
"""

from collections.abc import Mapping
from dataclasses import field
from typing import Any, Literal

from syncline_analyzer.fleet.identity import analysis_version
from syncline_analyzer.fleet.layout import Partition
from syncline_analyzer.fleet.recording import Recording
from syncline_analyzer.fleet.storage import Storage
from syncline_schemas.records import dataclass

Status = Literal["analyzed", "unchanged", "failed", "no capture", "worker died"]
Extra = Literal["samples", "report", "recording"]


@dataclass(frozen=True, slots=True)
class Settings:
    """What a user set for the analyses.

    Attributes:
        descriptions: TOML text of bus descriptions by machine; "" for all that have none.
        device_files: EDS and device files that these name.
        bitrate: of buses of which nothing tells it [bit/s].
        extras: what is made of each capture besides the tables.
    """

    descriptions: Mapping[str, str] = field(default_factory=dict)
    device_files: Mapping[str, bytes] = field(default_factory=dict)
    bitrate: int | None = None
    extras: tuple[Extra, ...] = ()

    def description(self, machine: str) -> str:
        """The bus description of a machine, "" where there is none."""
        return self.descriptions.get(machine) or self.descriptions.get("", "")

    def version(self, machine: str) -> str:
        """Version of the analysis of captures of a machine."""
        text = self.description(machine)
        files = sorted(self.device_files.items()) if text else []
        bitrate = str(self.bitrate or "")
        return analysis_version((text, *(f"{name}{content!r}" for name, content in files), bitrate))


@dataclass(frozen=True, slots=True)
class Task:
    """One recording to be analyzed into a data set.

    Attributes:
        version: of the analysis that is asked for.
        foreign: whether the worker may have another Syncline; then it refuses.
        options: of the file systems of the recording's URLs.
        earlier: where captures of the same recording or of the same files stand.
        run: name of the run, for what it leaves behind.
    """

    recording: Recording
    version: str
    settings: Settings
    out: Storage
    options: Mapping[str, Any]
    earlier: tuple[Partition, ...]
    run: str
    foreign: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a task.

    Attributes:
        reason: why it failed, in one line.
        partition: of the capture that stands now.
        cpu_s, peak_mb: what it took: processor time, and most memory of the worker meanwhile.
    """

    status: Status
    reason: str = ""
    partition: Partition | None = None
    content_sha256: str | None = None
    frames: int = 0
    verdict: str = ""
    errors: int = 0
    warnings: int = 0
    cpu_s: float = 0.0
    peak_mb: float | None = None


def analyze_task(task: Task) -> Outcome:
    """Do a task: what workers are asked to call."""
    from syncline_analyzer.fleet.work import analyze_recording

    return analyze_recording(task)
