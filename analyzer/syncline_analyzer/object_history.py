"""What one object of a node was over the capture: every change with its source and its reason."""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import field
from typing import Literal

from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

Source = Literal["sdo-read", "sdo-write", "bus-description", "eds-default"]
Cause = Literal["sdo-read", "sdo-write", "side effect", "reset", "factory reset"]
"""Why a value holds from a moment on."""
_WRITTEN: tuple[Cause, ...] = ("sdo-write", "side effect")
Value = int | bytes
CONFIRMED: tuple[Source, ...] = ("sdo-read", "sdo-write")
"""Sources that an answer of the node itself confirms."""
MAX_KEPT = 32
"""What a reset falls back to is known for so many changes of it: one may be told late."""
MAX_CHANGES = 20_000
"""Changes kept per object: a value polled for days must not fill the memory."""


@dataclass(frozen=True, slots=True)
class Known:
    """One object's value, where it comes from, and since when (`seq` is None when it always held)."""

    value: Value
    source: Source
    seq: int | None = None
    t_ns: int | None = None

    @property
    def confirmed(self) -> bool:
        """Whether the node itself told or acknowledged it."""
        return self.source in CONFIRMED


class Change(NamedTuple):
    """From `seq` on `known` holds; None: what a reset left is not known from the bus."""

    seq: int
    t_ns: int
    known: Known | None
    cause: Cause


class Span(NamedTuple):
    """A change and the frame at which the next one ends it; None: it holds to the end."""

    change: Change
    until_seq: int | None
    until_ns: int | None


class _Kept(NamedTuple):
    """From `seq` on a reset falls back to `saved` where the value is `unsaved`."""

    seq: int
    saved: Known | None
    unsaved: bool


@dataclass(slots=True)
class ObjectHistory:
    """Changes in order of `seq`; a reset falls back to `saved` once the value is `unsaved`."""

    seqs: list[int] = field(default_factory=list)
    changes: list[Change] = field(default_factory=list)
    saved: Known | None = None
    unsaved: bool = False
    _kept: list[_Kept] = field(default_factory=list)

    def keep(self, seq: int, saved: Known | None, *, unsaved: bool) -> None:
        """Note from `seq` on to what a reset falls back, and whether it does."""
        if (saved, unsaved) == (self.saved, self.unsaved):
            return
        self.saved, self.unsaved = saved, unsaved
        self._kept.append(_Kept(seq, saved, unsaved))
        del self._kept[:-MAX_KEPT]

    def reset(self, seq: int, t_ns: int) -> bool:
        """Fall back to what was saved at `seq`, also where later changes are known already.

        Returns: whether a value was thrown away.
        """
        at = bisect_right(self._kept, seq, key=lambda kept: kept.seq)
        kept = self._kept[at - 1] if at else _Kept(seq, None, unsaved=False)
        if not kept.unsaved:
            return False
        first = bisect_right(self.seqs, seq)
        later = self.changes[first:]
        self.seqs.insert(first, seq)
        self.changes.insert(first, Change(seq, t_ns, kept.saved, "reset"))
        later_kept = {each.seq: each for each in self._kept[at:]}
        del self._kept[at:]
        self.keep(seq, kept.saved, unsaved=False)
        for moment in sorted({change.seq for change in later} | later_kept.keys()):
            self._again(moment, later_kept.get(moment))
        return True

    def _again(self, seq: int, kept: _Kept | None) -> None:
        """Follow a moment after a reset that was told late: a change, a save or a restore."""
        change = self.changes[bisect_right(self.seqs, seq) - 1]
        if change.seq != seq:
            restored = kept is not None and kept.unsaved
            self.keep(seq, None if restored else change.known, unsaved=restored)
        elif change.cause in _WRITTEN:
            at_once = kept is not None and not kept.unsaved
            self.keep(seq, change.known if at_once else self.saved, unsaved=not at_once)
        elif not self.unsaved:
            self.keep(seq, change.known, unsaved=False)

    def add(self, change: Change) -> None:
        """Append a change; the older half goes where there are too many."""
        self.extend([change])

    def extend(self, changes: Sequence[Change]) -> None:
        """Append changes one by one."""
        begin = 0
        while begin < len(changes):
            stop = begin + MAX_CHANGES + 1 - len(self.seqs)
            part = changes[begin:stop]
            self.seqs += [change.seq for change in part]
            self.changes += part
            if len(self.seqs) > MAX_CHANGES:
                del self.seqs[: MAX_CHANGES // 2], self.changes[: MAX_CHANGES // 2]
            begin = stop

    def at(self, seq: int | None) -> Known | None:
        """What is known at `seq` (at the end when None)."""
        at = len(self.seqs) if seq is None else bisect_right(self.seqs, seq)
        return self.changes[at - 1].known if at else None

    @property
    def last(self) -> Known | None:
        """What is known at the end."""
        return self.changes[-1].known if self.changes else None

    @property
    def told(self) -> Known | None:
        """The last value that was known of it, also where a reset threw it away."""
        return next((each.known for each in reversed(self.changes) if each.known), None)

    def spans(self) -> Iterator[Span]:
        """Every change with its end; what another one at the same frame replaces is left out."""
        for change, after in zip(self.changes, [*self.changes[1:], None], strict=True):
            if after is None:
                yield Span(change, None, None)
            elif after.seq > change.seq:
                yield Span(change, after.seq, after.t_ns)
