"""What must stay as it is when the same bus is recorded in another way.

The frames of a scenario are cut into batches of other sizes, merged with a second bus, thinned by
a capture gap, or stamped by a clock that was set: each invariant analyzes them again.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from math import isclose
from random import Random
from typing import Any

import numpy as np

from syncline_analyzer.results import Analysis, Finding
from syncline_samples.faults import MoveEmcy
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.description import BusDescription
from tests.analyzer.fuzz_case import MS, Case, Item, S, analyzed

_ACCUSING = ("error", "warning")
_FRAME = re.compile(r"\bframe (\d+)")


def cut_anew(case: Case, random: Random) -> Iterator[str]:
    """The batches in which frames come change nothing."""
    items = [part for item in case.items for part in _parts(item, random)]
    other = analyzed(case.scenario, items, case.description)
    yield from unlike("batches", case.analysis, other)


def _parts(item: Item, random: Random) -> Iterator[Item]:
    if isinstance(item, Gap) or not len(item):
        yield item
        return
    cuts = sorted(random.randint(0, len(item)) for _ in range(random.randint(1, 4)))
    for begin, end in zip([0, *cuts], [*cuts, len(item)], strict=True):
        yield item[begin:end]


def second_bus(case: Case, random: Random) -> Iterator[str]:
    """Another bus with the same node ids does not change what is told of this one.

    The second bus carries the frames of this one, shifted in time and as far as they lie between
    its first and last frame; where the capture has gaps or a clock was set, nothing is compared.
    """
    if len(case.items) != 1 or case.steps or case.truth.error_frames:
        return
    frames = case.frames
    shift_ns = random.randint(200 * MS, 2 * S)
    inside = frames.t_ns + shift_ns < frames.t_ns[-1]
    other = replace(frames, bus=np.ones_like(frames.bus), t_ns=frames.t_ns + shift_ns)[inside]
    both = FrameBatch.concat([frames, other])
    order = np.argsort(both.t_ns, kind="stable")
    text = case.scenario.description_toml
    described = BusDescription.loads(text + text.replace("bus.can0", "bus.can1"))
    merged = analyzed(case.scenario, [both[order]], described, ("can0", "can1"))
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    for name in ("nodes", "nmt_commands", "nmt_states", "sync", "pdos", "emcy", "errors", "sdo"):
        mine = [row for row in getattr(merged, name) if row.bus == "can0"]
        alone = list(getattr(case.analysis, name))
        yield from unlike(f"second bus: {name}", placed(alone, place), mine)
    mine = [finding for finding in merged.findings if finding.bus != "can1"]
    yield from unlike("second bus: findings", placed(case.analysis.findings, place), mine)


def placed(value: Any, place: np.ndarray[Any, np.dtype[np.int64]]) -> Any:
    """Rows with every `seq` as it is in the merged capture."""
    if isinstance(value, list):
        return [placed(each, place) for each in value]
    if not is_dataclass(value) or isinstance(value, type):
        return value
    changed: dict[str, Any] = {}
    for each in fields(value):
        old = getattr(value, each.name)
        if isinstance(old, np.ndarray):
            changed[each.name] = place[old] if each.name.endswith("seq") else old
        elif each.name.endswith("seq") or each.name == "evidence":
            new = [int(place[seq]) for seq in old] if isinstance(old, list) else old
            changed[each.name] = int(place[new]) if isinstance(new, int) else new
        elif isinstance(old, list):
            changed[each.name] = placed(old, place)
        elif isinstance(old, str):
            changed[each.name] = _FRAME.sub(lambda told: f"frame {place[int(told[1])]}", old)
    return replace(value, **changed)


def blinded(case: Case, random: Random) -> Iterator[str]:
    """A gap in the capture accuses no node of anything.

    Where it hides the write that gave a node's EMCYs another identifier, they are those of the node
    that this identifier belongs to by default.
    """
    frames = case.frames
    if len(case.items) != 1 or not len(frames):
        return
    begin_ns = random.randint(int(frames.t_ns[0]), int(frames.t_ns[-1]))
    end_ns = begin_ns + random.randint(20 * MS, 3 * S)
    before, after = frames.t_ns < begin_ns, frames.t_ns >= end_ns
    if (np.diff(frames.t_ns) < 0).any() or not after.any():
        return
    lost = int((~before & ~after).sum())
    gap = Gap(begin_ns, end_ns, "adapter lost", lost, 0)
    other = analyzed(case.scenario, [frames[before], gap, frames[after]], case.description)
    moved = {
        fault.can_id & 0x7F
        for fault in case.scenario.faults
        if isinstance(fault, MoveEmcy)
        and begin_ns <= case.at(fault.at_s) + S
        and not (end_ns <= case.at(fault.at_s))
    }
    yield from _accused("capture gap", case, other, moved)


def clock_set(case: Case, random: Random) -> Iterator[str]:
    """A step of the recorder's clock accuses no node of anything.

    Not where the script sets the clock as well within a second: no heartbeat comes between the two.
    """
    if len(case.items) != 1:
        return
    frames, row = case.frames, random.randint(1, max(1, len(case.frames) - 1))
    step_ns = random.choice((-1, 1)) * random.randint(20, 5000) * MS
    at_ns = int(frames.t_ns[min(row, len(frames) - 1)])
    if any(abs(at_ns - case.stamp(own_ns)) < S + abs(by_ns) for own_ns, by_ns in case.steps):
        return
    t_ns = frames.t_ns.copy()
    t_ns[row:] += step_ns
    other = analyzed(case.scenario, [replace(frames, t_ns=t_ns)], case.description)
    yield from _accused(f"clock step of {step_ns // MS} ms", case, other)


def _accused(what: str, case: Case, other: Analysis, moved: Collection[int] = ()) -> Iterator[str]:
    """What nobody is accused of otherwise, but for the EMCYs under the numbers in `moved`."""
    known = {key for finding in case.analysis.findings for key in _keys(finding)}
    known |= {(each.id, each.node) for each in case.truth.findings}
    for finding in other.findings:
        if finding.severity in _ACCUSING and finding.node is not None:
            new = [
                key
                for key in _keys(finding)
                if key not in known and not (key[1] in moved and key[0].startswith("emcy."))
            ]
            if new:
                yield f"{what}: {new} accused: {finding.text}"


def _keys(finding: Finding) -> list[tuple[str, int | None]]:
    links = [(link.id, link.node) for link in finding.chain]
    return [(finding.id, finding.node), *links]


def unlike(where: str, one: Any, other: Any) -> Iterator[str]:
    """Where two values differ; numbers may be rounded otherwise."""
    if is_dataclass(one) and not isinstance(one, type) and type(one) is type(other):
        for each in fields(one):
            yield from unlike(
                f"{where}.{each.name}", getattr(one, each.name), getattr(other, each.name)
            )
    elif isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        if one.shape != other.shape or not np.allclose(one, other, equal_nan=True):
            yield f"{where}: arrays differ"
    elif isinstance(one, float) and isinstance(other, float):
        if not isclose(one, other, rel_tol=1e-6, abs_tol=1e-6):
            yield f"{where}: {one} and {other}"
    elif isinstance(one, list | tuple) and isinstance(other, list | tuple):
        yield from _unlike_rows(where, one, other)
    elif isinstance(one, Mapping) and isinstance(other, Mapping):
        if one.keys() != other.keys():
            yield f"{where}: {sorted(map(str, one))} and {sorted(map(str, other))}"
        for key in one.keys() & other.keys():
            yield from unlike(f"{where}[{key}]", one[key], other[key])
    elif one != other:
        yield f"{where}: {one!r} and {other!r}"


def _unlike_rows(where: str, one: Any, other: Any) -> Iterator[str]:
    if len(one) != len(other):
        missing = [row for row in one if row not in other][:1]
        added = [row for row in other if row not in one][:1]
        yield f"{where}: {len(one)} and {len(other)} rows, without {missing}, with {added}"
        return
    for mine, its in zip(one, other, strict=True):
        yield from unlike(where, mine, its)


Invariant = Callable[[Case, Random], Iterator[str]]
INVARIANTS: tuple[Invariant, ...] = (cut_anew, second_bus, blinded, clock_set)


def broken(case: Case, random: Random) -> list[str]:
    """What changes although it must not, under one way of recording drawn by chance."""
    invariant = random.choice(INVARIANTS)
    return [f"{invariant.__name__}: {text}" for text in invariant(case, random)][:5]
