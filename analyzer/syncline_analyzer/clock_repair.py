"""Stamps of recorders whose clock was set while they recorded, moved to the time it told then."""

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from itertools import groupby
from typing import TYPE_CHECKING

from syncline_analyzer.capture import CaptureReader
from syncline_analyzer.readers.own import own_captures
from syncline_schemas.capture.clock_history import PLAUSIBLE_NS, ClockHistory, ClockRepair
from syncline_schemas.wording import counted

if TYPE_CHECKING:
    from syncline_analyzer.readers.mcap import McapReader

MAX_TOLD = 5
"""Settings of a clock that are told one by one."""
_SECOND_NS = 1_000_000_000
_NEVER = (
    "the recorder's clock was never set while it recorded: its times count from {date}; a later"
    " file of the same recording, analyzed together with this one, can tell the true time"
)


def repair_clocks(readers: Iterable[CaptureReader]) -> None:
    """Make the readers give right stamps, each recording's files by the samples of all of them.

    To be called before the first batch is read. What was done, and what cannot be done, is added
    to the notes of each capture.
    """
    ours = [each for each in own_captures(readers) if each.recording_id]
    ours.sort(key=lambda each: (each.recording_id, each.segment))
    for _, files in groupby(ours, key=lambda each: each.recording_id):
        _repair(list(files))


def _repair(files: "Sequence[McapReader]") -> None:
    history = ClockHistory()
    for each in files:
        each.add_clock_samples(history)
    repair = history.repair()
    note = _note(history, repair)
    for each in files:
        if repair is not None:
            each.repair_clock(repair)
        if note and note not in each.facts.notes:
            each.facts.notes.append(note)


def _note(history: ClockHistory, repair: ClockRepair | None) -> str:
    if repair is not None:
        steps = [(each.begin_log_ns, each.step_ns) for each in repair.epochs[1:]]
        told = ", ".join(_set(step_ns) for _, step_ns in steps[:MAX_TOLD])
        more = f" and {len(steps) - MAX_TOLD} more" if len(steps) > MAX_TOLD else ""
        return (
            f"the recorder's clock was set {counted(len(steps), 'time')} while it recorded"
            f" ({told}{more}); its stamps were moved to what it said"
            f" {'after that' if len(steps) == 1 else 'last'}, by up to"
            f" {_duration(repair.largest_ns)}"
        )
    if history.epochs and history.last_utc_ns < PLAUSIBLE_NS:
        first = history.epochs[0]
        date = datetime.fromtimestamp((first.elapsed_ns + first.utc_offset_ns) // _SECOND_NS, UTC)
        return _NEVER.format(date=f"{date:%Y-%m-%d}")
    return ""


def _set(step_ns: int) -> str:
    return f"{'forward' if step_ns > 0 else 'back'} by {_duration(step_ns)}"


def _duration(ns: int) -> str:
    """A length of time as people say it.

    >>> _duration(-86_400_000_000_000 * 3), _duration(4_500_000_000)
    ('3.0 days', '4.500 s')
    """
    seconds = abs(ns) / _SECOND_NS
    if seconds >= 2 * 86_400:
        return f"{seconds / 86_400:.1f} days"
    return f"{seconds / 3_600:.1f} h" if seconds >= 2 * 3_600 else f"{seconds:.3f} s"
