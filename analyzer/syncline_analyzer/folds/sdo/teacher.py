"""What SDO transfers teach the object-dictionary shadow: plain reads in columns, the rest singly."""

from collections.abc import Callable, Iterator, Sequence
from heapq import heapify, heappop, heappush

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.sdo.channel import SdoChannel
from syncline_analyzer.folds.sdo.pairs import Plain
from syncline_analyzer.folds.sdo.values import known_value, known_values
from syncline_analyzer.object_history import Known, Value
from syncline_analyzer.shadow import Shadow
from syncline_schemas.canopen.sdo import LOAD_SIGNATURE, SAVE_SIGNATURE
from syncline_schemas.devices import quirks
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

STORE, RESTORE = 0x1010, 0x1011
_PDOS = range(0x1800, 0x1A00)
_ANY_BIT = 0xFFFFFFFF
Key = tuple[int, int]


class Lesson(NamedTuple):
    """What one transfer tells: a value, or (`data` is None) that the node has no such object."""

    place: int
    bus: int
    node: int
    key: Key
    write: bool
    data: bytes | None
    seq: int
    t_ns: int


Told = tuple[Lesson, Value | None]
"""A transfer, and the value that it tells."""


class Teacher:
    """Gives the shadow what transfers tell, in the order in which they ended.

    The plain transfers of an object that concern nothing else are taken in as columns: at the end
    of the stretch, or before anything that concerns the object, too. Of other objects, a plain read
    that brings what the one before it brought changes nothing and is left out.
    """

    def __init__(self, shadow: Shadow) -> None:
        self._shadow = shadow

    def teach(
        self, lessons: Sequence[Lesson], plain: Plain, channels: Sequence[SdoChannel]
    ) -> list[Told]:
        """Take in a stretch; `lessons` are the transfers that are not plain, by their places.

        Returns: these with the values that they tell.
        """
        shadow, told = self._shadow, []
        objects = _Objects(plain, channels)
        objects.take_singly(self._columnar)
        for lesson, plain_one in objects.among(lessons):
            bus, node = lesson.bus, lesson.node
            if not self._concerns_others(bus, node, lesson.key):
                self._read(objects, objects.of_object(lesson), lesson.place)
            elif not self._confirms(lesson):
                self._read(objects, objects.of_node(bus, node), lesson.place)
            before = shadow.upset, shadow.device(bus, node)
            value = self.take(lesson)
            told.append((lesson, value))
            if shadow.upset != before[0] or shadow.device(bus, node) is not before[1]:
                objects.look_again(bus, node, lesson.place, self._columnar)
            elif not (
                plain_one and value is not None and shadow.repeats(bus, node, lesson.key, value)
            ):
                objects.look_at_next(lesson)
        self._read(objects, objects.all, None)
        return told

    def take(self, lesson: Lesson) -> Value | None:
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
            source = "sdo-write" if lesson.write else "sdo-read"
            known = Known(value, source, lesson.seq, lesson.t_ns)  # type: ignore[arg-type]
            shadow.learn(bus, node, index, sub, known)
        return value

    def _read(self, objects: "_Objects", which: Sequence["_Object"], place: int | None) -> None:
        """Take in the columns of objects up to a place."""
        plain = objects.plain
        stop = objects.rows_before(place)
        for each in which:
            rows = each.take(stop)
            if len(rows):
                device = self._shadow.device(each.bus, each.node)
                values = known_values(device, *each.key, plain.word[rows], plain.size[rows])
                moments = plain.end_seq[rows], plain.end_ns[rows]
                told = values, plain.read[rows], *moments
                self._shadow.learn_columns(each.bus, each.node, each.key, *told)

    def _confirms(self, lesson: Lesson) -> bool:
        """Whether a transfer only tells what is known."""
        shadow, bus, node = self._shadow, lesson.bus, lesson.node
        if lesson.data is None:
            return shadow.is_refused(bus, node, *lesson.key)
        value = known_value(shadow.device(bus, node), *lesson.key, lesson.data)
        return not lesson.write and shadow.repeats(bus, node, lesson.key, value)

    def _columnar(self, each: "_Object") -> bool:
        """Whether transfers of an object concern nothing but the object."""
        return not self._concerns_others(each.bus, each.node, each.key)

    def _concerns_others(self, bus: int, node: int, key: Key) -> bool:
        """Whether an object may change what others of its node are, or how they are read."""
        facts = quirks(self._shadow.device(bus, node))
        return (
            self._shadow.tells(key[0])
            or key[0] in (STORE, RESTORE)
            or key in facts.reset_writes
            or key in facts.factory_reset_writes
            or key in facts.aliases
            or any(written == key for written, _, _ in facts.side_effects)
            or (key[1] == 1 and key[0] in _PDOS and facts.pdo_cob_id_mask != _ANY_BIT)
        )


@dataclass(slots=True)
class _Object:
    """Plain transfers of one object: rows (n,) in order; those from `reached` on are to be read."""

    bus: int
    node: int
    key: Key
    rows: NDArray[np.intp]
    columnar: bool = True
    reached: int = 0

    def take(self, stop: int) -> NDArray[np.intp]:
        """The rows before another one that are taken in as columns, each told once."""
        if not self.columnar:
            return self.rows[:0]
        first, self.reached = self.reached, int(self.rows.searchsorted(stop))
        return self.rows[first : self.reached]


class _Objects:
    """The plain transfers of a stretch by object, and those that are looked at one by one."""

    def __init__(self, plain: Plain, channels: Sequence[SdoChannel]) -> None:
        self.plain = plain
        owners: dict[Key, int] = {}
        self._channels = [(each.bus, each.node) for each in channels]
        of = [owners.setdefault(each, len(owners)) for each in self._channels]
        listed = list(owners)
        name = np.array(of, np.int64)[plain.channel] << 24 | plain.name
        self._order = np.argsort(name, kind="stable")
        self._ordered = ordered = name[self._order]
        cuts = np.flatnonzero(ordered[1:] != ordered[:-1]) + 1
        names = ordered[[0, *cuts]].tolist() if len(name) else []
        self.all: list[_Object] = []
        for each, rows in zip(names, np.split(self._order, cuts), strict=False):
            bus, node = listed[each >> 24]
            self.all.append(_Object(bus, node, (each & 0xFFFF, each >> 16 & 0xFF), rows))
        self._by_name = {(each.bus, each.node, each.key): each for each in self.all}
        self._by_node: dict[Key, list[_Object]] = {}
        for each in self.all:
            self._by_node.setdefault((each.bus, each.node), []).append(each)
        self._new = self._news()
        self._heap: list[int] = []
        self._last = -1

    def of_node(self, bus: int, node: int) -> Sequence[_Object]:
        """Objects of one node."""
        return self._by_node.get((bus, node), ())

    def of_object(self, lesson: Lesson) -> Sequence[_Object]:
        """The object that a transfer names, if it has plain ones."""
        each = self._by_name.get((lesson.bus, lesson.node, lesson.key))
        return () if each is None else (each,)

    def take_singly(self, columnar: Callable[[_Object], bool]) -> None:
        """Choose what is looked at one by one: objects that are not `columnar`."""
        for each in self.all:
            if not columnar(each):
                self._take_singly(each)
        heapify(self._heap)

    def among(self, lessons: Sequence[Lesson]) -> Iterator[tuple[Lesson, bool]]:
        """What is looked at one by one, in order, and whether it is plain; more may come meanwhile."""
        for lesson in lessons:
            yield from self._up_to(lesson.place)
            yield lesson, False
        yield from self._up_to(None)

    def look_at_next(self, lesson: Lesson) -> None:
        """Look at the next plain transfer of an object after one of its transfers, too."""
        for each in self.of_object(lesson):
            if not each.columnar:
                self._push_next(each, lesson.place)

    def look_again(
        self, bus: int, node: int, place: int, columnar: Callable[[_Object], bool]
    ) -> None:
        """Look at the next plain transfer of every object of a node after a place, too."""
        for each in self.of_node(bus, node):
            if each.columnar and not columnar(each):
                self._take_singly(each)
                heapify(self._heap)
            if not each.columnar:
                self._push_next(each, place)

    def rows_before(self, place: int | None) -> int:
        """Up to which row transfers ended before a place."""
        answer = self.plain.answer
        return len(answer) if place is None else int(answer.searchsorted(place))

    def _news(self) -> NDArray[np.bool_]:
        """(n,) False for reads that bring what the transfer of the object before, a read, brought."""
        plain, order = self.plain, self._order
        told = plain.word.astype(np.int64) | plain.size.astype(np.int64) << 32
        told = np.where(plain.read, told, -1)[order]
        same = (told[1:] == told[:-1]) & (told[1:] >= 0)
        same &= self._ordered[1:] == self._ordered[:-1]
        new = np.ones(len(plain), np.bool_)
        new[order[1:]] = ~same
        return new

    def _up_to(self, place: int | None) -> Iterator[tuple[Lesson, bool]]:
        """Plain transfers before a place that are to be looked at."""
        while self._heap and self._heap[0] < self.rows_before(place):
            row = heappop(self._heap)
            if row != self._last:
                self._last = row
                yield self._lesson(row), True

    def _take_singly(self, each: _Object) -> None:
        """From what is reached of an object on, look at its news one by one."""
        rows = each.rows[each.reached :]
        each.columnar = False
        self._heap += rows[self._new[rows]].tolist()

    def _push_next(self, each: _Object, place: int) -> None:
        at = int(each.rows.searchsorted(self.rows_before(place + 1)))
        if at < len(each.rows):
            heappush(self._heap, int(each.rows[at]))

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
