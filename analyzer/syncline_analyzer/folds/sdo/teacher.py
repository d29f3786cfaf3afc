"""What SDO transfers teach the object-dictionary shadow: of columns only news are looked at."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.sdo.channel import SdoChannel
from syncline_analyzer.folds.sdo.pairs import Plain
from syncline_analyzer.folds.sdo.values import known_value
from syncline_analyzer.object_history import Known
from syncline_analyzer.reads import Reads, raw_of
from syncline_analyzer.shadow import Shadow
from syncline_schemas.canopen.sdo import LOAD_SIGNATURE, SAVE_SIGNATURE

STORE, RESTORE = 0x1010, 0x1011
Key = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Lesson:
    """What one transfer tells: a value, or (`data` is None) that the node has no such object."""

    place: int
    bus: int
    node: int
    key: Key
    write: bool
    data: bytes | None
    seq: int
    t_ns: int


class Teacher:
    """Gives the shadow what transfers tell, in the order in which they ended.

    A plain read that brings what the one before it brought changes nothing: only first ones and
    changed ones are looked at, and those after anything else that may have changed the value.
    """

    def __init__(self, shadow: Shadow) -> None:
        self._shadow = shadow

    def teach(
        self, lessons: Sequence[Lesson], plain: Plain, channels: Sequence[SdoChannel]
    ) -> list[tuple[Lesson, int | bytes | None]]:
        """Take in a stretch; `lessons` are the transfers that are not plain, by their places.

        Returns: these with the values that they tell.
        """
        shadow, news = self._shadow, _News(plain, channels)
        told = []
        for lesson in news.among(lessons):
            place = lesson.bus, lesson.node
            if shadow.tells(lesson.key[0]):
                self._confirm(news, lesson.place)
            before = shadow.upset, shadow.device(*place)
            value = self.take(lesson)
            told.append((lesson, value))
            if shadow.upset != before[0] or shadow.device(*place) is not before[1]:
                news.look_again(lesson.place)
            elif value is None or not shadow.repeats(*place, lesson.key, value):
                news.look_at_next(lesson)
        self._confirm(news, None)
        return told

    def take(self, lesson: Lesson) -> int | bytes | None:
        """Take in one transfer; returns the value that it tells."""
        shadow, bus, node = self._shadow, lesson.bus, lesson.node
        if lesson.data is None:
            shadow.refuse(bus, node, *lesson.key)
            return None
        index, sub = lesson.key
        value = known_value(shadow.device(bus, node), index, sub, lesson.data)
        if lesson.write and index == STORE and value == SAVE_SIGNATURE:
            shadow.save(bus, node, lesson.seq, sub)
        elif lesson.write and index == RESTORE and value == LOAD_SIGNATURE:
            shadow.restore(bus, node, lesson.seq, sub)
        else:
            known = Known(
                value, "sdo-write" if lesson.write else "sdo-read", lesson.seq, lesson.t_ns
            )
            shadow.learn(bus, node, index, sub, known)
        return value

    def _confirm(self, news: "_News", place: int | None) -> None:
        """Give the shadow the reads of positions that told nothing new, up to a place."""
        shadow, plain = self._shadow, news.plain
        for bus, node, key, rows in news.repeats(place):
            if not shadow.is_position(bus, node, key):
                continue
            device = shadow.device(bus, node)
            distinct, first, of = np.unique(news.told[rows], return_index=True, return_inverse=True)
            values = (known_value(device, *key, plain.data(at)) for at in rows[first].tolist())
            raw = np.fromiter(map(raw_of, values), np.int64, len(distinct))
            shadow.confirm(bus, node, key, Reads(plain.end_seq[rows], plain.end_ns[rows], raw[of]))


class _News:
    """Plain transfers by object, and which of them are to be looked at."""

    def __init__(self, plain: Plain, channels: Sequence[SdoChannel]) -> None:
        self.plain = plain
        owners: dict[Key, int] = {}
        of = [owners.setdefault((each.bus, each.node), len(owners)) for each in channels]
        self._channels = [(each.bus, each.node) for each in channels]
        self._owners = list(owners)
        self._numbers = owners
        owner = np.array(of, np.int64)[plain.channel]
        name = owner << 24 | plain.name
        self._order = order = np.argsort(name, kind="stable")
        self._names = name[order]
        self.told = plain.word.astype(np.int64) | plain.size.astype(np.int64) << 32
        told = self.told[order]
        same = plain.read[order[1:]] & plain.read[order[:-1]] & (told[1:] == told[:-1])
        same &= self._names[1:] == self._names[:-1]
        new = np.ones(len(plain), np.bool_)
        new[order[1:]] = ~same
        self._heap: list[int] = np.flatnonzero(new).tolist()
        self._looked_at = new
        self._repeated = 0

    def among(self, lessons: Sequence[Lesson]) -> Iterator[Lesson]:
        """The transfers to look at, those of other kinds among them; more may come meanwhile."""
        for lesson in lessons:
            yield from self._up_to(lesson.place)
            yield lesson
        yield from self._up_to(None)

    def look_at_next(self, lesson: Lesson) -> None:
        """Look at the next plain transfer of an object after one of its transfers, too."""
        owner = self._numbers.get((lesson.bus, lesson.node))
        if owner is None:
            return
        name = owner << 24 | lesson.key[1] << 16 | lesson.key[0]
        first, stop = np.searchsorted(self._names, (name, name + 1))
        rows = self._order[first:stop]
        at = int(np.searchsorted(self.plain.answer[rows], lesson.place, "right"))
        if at < len(rows):
            self._push(int(rows[at]))

    def look_again(self, place: int) -> None:
        """Look at the next plain transfer of every object after a place, too."""
        later = self._order[self.plain.answer[self._order] > place]
        name = self._names[self.plain.answer[self._order] > place]
        first = np.ones(len(name), np.bool_)
        first[1:] = name[1:] != name[:-1]
        for row in later[first].tolist():
            self._push(row)

    def repeats(self, place: int | None) -> Iterator[tuple[int, int, Key, NDArray[np.intp]]]:
        """By object, the reads before a place (all) that were not looked at, each told once."""
        upto = len(self.plain)
        if place is not None:
            upto = int(np.searchsorted(self.plain.answer, place))
        first, self._repeated = self._repeated, max(upto, self._repeated)
        edges = [*np.flatnonzero(self._names[1:] != self._names[:-1]) + 1, len(self._names)]
        begin = 0
        for stop in edges if first < upto else ():
            rows = self._order[begin:stop]
            rows = rows[(rows >= first) & (rows < upto) & ~self._looked_at[rows]]
            bus, node = self._owners[int(self._names[begin]) >> 24]
            name = int(self._names[begin]) & 0xFFFFFF
            begin = stop
            if len(rows):
                yield bus, node, (name & 0xFFFF, name >> 16), rows

    def _up_to(self, place: int | None) -> Iterator[Lesson]:
        heap, answer, last = self._heap, self.plain.answer, -1
        while heap and (place is None or answer[heap[0]] < place):
            row = heappop(heap)
            if row != last:
                yield self._lesson(row)
            last = row

    def _push(self, row: int) -> None:
        self._looked_at[row] = True
        heappush(self._heap, row)

    def _lesson(self, row: int) -> Lesson:
        plain = self.plain
        name = int(plain.name[row])
        bus, node = self._channels[int(plain.channel[row])]
        return Lesson(
            int(plain.answer[row]),
            bus,
            node,
            (name & 0xFFFF, name >> 16),
            not plain.read[row],
            plain.data(row),
            int(plain.end_seq[row]),
            int(plain.end_ns[row]),
        )
