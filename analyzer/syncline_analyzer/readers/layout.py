"""The layout of a log line: where its fields stand, learned from one line, applied to thousands.

A format understands one line by a regular expression and gives the places of its fields as a
`FrameLayout`. Every other line of the same length whose remaining characters are the same, and
whose fields hold digits in the same places, is then read without looking at it singly.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import field
from functools import partial
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.readers.columns import (
    TRANSLATION,
    Words,
    compact_bytes,
    decimal_number,
    hex_number,
    spaced_bytes,
)
from syncline_schemas import native
from syncline_schemas.records import dataclass

Row = tuple[int, int, int, int, int, bytes]
"""(t_ns, bus, can_id, flags, dlc, data) of one frame, as `FrameBatch.from_rows` takes it."""

Span = tuple[int, int]
"""[start, end) of a field in its line."""

MAX_LINE = 512
"""Longer lines are read one by one."""
_WORD = 8
_EFFECTIVE_DIGITS = 8
MAX_DATA_STEP = 8
_BYTE = re.compile(rb"(?<![0-9A-Fa-f])[0-9A-Fa-f]{2}(?![0-9A-Fa-f])")
_ROWS = re.compile(rb"[0-9A-Fa-f]+")
_ALIKE = re.compile(rb"[\x00-\x08\x0a-\x0c\x0e-\x1f]")
"""Characters that `TRANSLATION` makes the same."""


@dataclass(frozen=True, slots=True)
class FrameLayout:
    """Where the fields of one frame's line stand.

    Attributes:
        bus, flags, dlc: the same for every line of this layout.
        id_span: the identifier's digits, at most eight, in base `id_base`, each line's value
            being at least `id_least` and at most `id_limit`.
        data_start, data_step: first character of the first data byte, and characters from one
            byte to the next (2 to `MAX_DATA_STEP`).
        data_count: data bytes in the line.
        times: decimal digits and what one is worth in ns.
        t_base_ns: added to the time.
        digits: further decimal digits that mean nothing.
        anything: further characters that mean nothing.
    """

    bus: int
    flags: int
    dlc: int
    id_span: Span
    times: tuple[tuple[Span, int], ...] = ()
    data_start: int = 0
    data_step: int = 2
    data_count: int = 0
    t_base_ns: int = 0
    id_base: int = 16
    id_limit: int = 0x7FF
    id_least: int = 0
    id_constant: int = 0
    digits: tuple[Span, ...] = ()
    anything: tuple[Span, ...] = ()

    def row(self, line: bytes) -> Row | None:
        """The frame in one line, or None when its identifier is out of range."""
        start, end = self.id_span
        can_id = self.id_constant + int(line[start:end], self.id_base)
        if not self.id_least <= can_id <= self.id_limit:
            return None
        t_ns = self.t_base_ns + sum(int(line[a:b]) * worth for (a, b), worth in self.times)
        places = range(
            self.data_start, self.data_start + self.data_step * self.data_count, self.data_step
        )
        data = bytes(int(line[place : place + 2], 16) for place in places)
        return (t_ns, self.bus, can_id, self.flags, self.dlc, data)


@dataclass(slots=True)
class LineBatch:
    """Lines of one block, and the columns read so far.

    Attributes:
        plain: the block.
        starts: (n,) where each line starts in `text`.
        read: (n,) whether the line was read as a frame.
        timed: (n,) whether the line has a time of its own.
        words: (n, 1) or (n, 8) data bytes.
    """

    plain: bytes
    starts: NDArray[np.intp]
    t_ns: NDArray[np.int64]
    bus: NDArray[np.uint8]
    can_id: NDArray[np.uint32]
    flags: NDArray[np.uint16]
    dlc: NDArray[np.uint8]
    words: Words
    read: NDArray[np.bool_]
    timed: NDArray[np.bool_]
    _text: bytes = b""

    @property
    def text(self) -> bytes:
        """The block translated, eight spare bytes before and enough behind each line."""
        if not self._text:
            room = bytes(MAX_LINE + 4 * _WORD)
            self._text = b"".join((room[:_WORD], self.plain.translate(TRANSLATION), room))
        return self._text

    def put_row(self, line: int, row: Row, *, timed: bool) -> None:
        """Put in one frame that was read by itself."""
        t_ns, bus, can_id, flags, dlc, data = row
        self.t_ns[line], self.bus[line], self.can_id[line] = t_ns, bus, can_id
        self.flags[line], self.dlc[line] = flags, dlc
        self.read[line], self.timed[line] = True, timed
        self.widen(len(data))
        self.words[line] = np.frombuffer(data.ljust(8 * self.words.shape[1], b"\0"), "<u8")

    def widen(self, data_count: int) -> None:
        """Make room for frames of more than eight bytes."""
        if data_count > 8 and self.words.shape[1] == 1:
            wide = np.zeros((len(self.words), 8), np.uint64)
            wide[:, :1] = self.words
            self.words = wide


@dataclass(slots=True)
class LineMatcher:
    """A layout compiled for whole blocks of lines."""

    layout: FrameLayout
    length: int
    hits: int = 0
    idle: int = 0
    _tests: list[tuple[int, int, int]] = field(default_factory=list)
    _digit_tests: list[tuple[int, int]] = field(default_factory=list)
    _times: list[tuple[Span, int]] = field(default_factory=list)
    _t_constant: int = 0
    numbers: list[int] | None = None
    """The layout as `native/lines.c` takes it; None where it cannot."""

    @classmethod
    def learn(cls, layout: FrameLayout, line: bytes) -> "LineMatcher | None":
        """Compile a layout found in `line`; None when such lines have to be read one by one."""
        if len(line) > MAX_LINE:
            return None
        matcher = cls(layout, len(line))
        matcher._t_constant = layout.t_base_ns
        for span, worth in layout.times:
            matcher._split_time(line, span, worth)
        matcher._compile(line)
        matcher.numbers = matcher._native_numbers(line)
        return matcher

    def _split_time(self, line: bytes, span: Span, worth: int) -> None:
        # The leading digits of an epoch change once in years: they stay part of the layout.
        start, end = span
        low = max(start, end - _EFFECTIVE_DIGITS)
        self._times.append(((low, end), worth))
        if low > start:
            self._t_constant += int(line[start:low]) * 10 ** (end - low) * worth

    def _compile(self, line: bytes) -> None:
        layout = self.layout
        codes = np.zeros(_padded(self.length), np.uint8)
        codes[: self.length] = np.frombuffer(line.translate(TRANSLATION), np.uint8)
        mask = np.zeros_like(codes)
        mask[: self.length] = 0xFF
        decimal = np.zeros_like(codes)
        spans = [span for span, _ in self._times] + list(layout.digits)
        if layout.id_base == 10:
            spans.append(layout.id_span)
        for start, end in spans:
            decimal[start:end], codes[start:end], mask[start:end] = 1, 0, 0xF0
        for start, end in self._hex_spans():
            codes[start:end], mask[start:end] = 0, 0xE0
        for start, end in layout.anything:
            codes[start:end], mask[start:end] = 0, 0
        self._tests = [
            (k, int(code), int(bits))
            for k, (code, bits) in enumerate(
                zip(codes.view(np.uint64), mask.view(np.uint64), strict=True)
            )
            if bits
        ]
        self._digit_tests = [
            (k, int(word) * 0x0F) for k, word in enumerate(decimal.view(np.uint64)) if word
        ]

    def _native_numbers(self, line: bytes) -> list[int] | None:
        """The same for the characters themselves."""
        if _ALIKE.search(line):
            return None
        layout = self.layout
        codes, masks = bytearray(_padded(self.length)), bytearray(_padded(self.length))
        codes[: self.length], masks[: self.length] = line, b"\xff" * self.length
        digits = [piece for span in layout.digits for piece in _pieces(span)]
        times = [(*span, worth) for span, worth in self._times]
        spans = [layout.id_span, *digits, *(span for span, _ in self._times)]
        for start, end in [*spans, *self._hex_spans(), *layout.anything]:
            codes[start:end] = masks[start:end] = bytes(end - start)
        tests = [
            (at // _WORD, _signed(codes[at : at + _WORD]), _signed(masks[at : at + _WORD]))
            for at in range(0, len(codes), _WORD)
            if any(masks[at : at + _WORD])
        ]
        head = (
            *(len(tests), len(digits), len(times)),
            *(layout.bus, layout.flags, layout.dlc),
            *(*layout.id_span, int(layout.id_base == 16)),
            *(layout.id_limit, layout.id_least, layout.id_constant),
            *(layout.data_start, layout.data_step, layout.data_count, self._t_constant),
        )
        return [*head, *chain.from_iterable((*tests, *digits, *times))]

    def _hex_spans(self) -> list[Span]:
        layout = self.layout
        spans = [layout.id_span] if layout.id_base == 16 else []
        for i in range(layout.data_count):
            start = layout.data_start + i * layout.data_step
            spans.append((start, start + 2))
        return spans

    def read(self, batch: LineBatch, lines: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Read those of the lines that have this layout; (n,) which."""
        if len(lines) == 0:
            return np.zeros(0, np.bool_)
        # One copy of each line with eight bytes before it, so that every field ends a whole word.
        width = _WORD + _padded(self.length) + _WORD
        rows = np.ndarray((len(batch.text) - width + 1,), f"V{width}", batch.text, 0, (1,))[
            batch.starts[lines] - _WORD
        ]
        words = rows.view(np.uint64).reshape(len(lines), width // _WORD)
        bad = np.zeros(len(lines), np.uint64)
        for k, code, bits in self._tests:
            bad |= (words[:, k + 1] ^ code) & bits
        for k, bits in self._digit_tests:
            # 10..15 plus 6 carries into the next four bits.
            bad |= ((words[:, k + 1] & bits) + bits // 0x0F * 6) & (bits // 0x0F * 0x10)
        good: NDArray[np.bool_] = bad == 0
        can_id = self._can_id(rows, width)
        good &= can_id <= self.layout.id_limit
        if self.layout.id_least:
            good &= can_id >= self.layout.id_least
        if not good.all():
            rows, lines, can_id = rows[good], lines[good], can_id[good]
        if len(lines):
            self._put(batch, lines, rows, width, can_id)
        return good

    def _can_id(self, rows: NDArray[np.void], width: int) -> Words:
        start, end = self.layout.id_span
        words = _window(rows, width, end)
        number = hex_number if self.layout.id_base == 16 else decimal_number
        return number(words, end - start) + self.layout.id_constant

    def _put(
        self,
        batch: LineBatch,
        lines: NDArray[np.intp],
        rows: NDArray[np.void],
        width: int,
        can_id: Words,
    ) -> None:
        layout = self.layout
        if self._times:
            t_ns = np.full(len(lines), self._t_constant, np.int64)
            for (start, end), worth in self._times:
                value = decimal_number(_window(rows, width, end), end - start)
                t_ns += value.view(np.int64) * worth
            batch.t_ns[lines] = t_ns
            batch.timed[lines] = True
        batch.bus[lines] = layout.bus
        batch.can_id[lines] = can_id
        batch.flags[lines] = layout.flags
        batch.dlc[lines] = layout.dlc
        batch.read[lines] = True
        batch.widen(layout.data_count)
        for k in range((layout.data_count + 7) // 8):
            batch.words[lines, k] = self._data_word(rows, width, k)

    def _data_word(self, rows: NDArray[np.void], width: int, k: int) -> Words:
        layout = self.layout
        count = min(8, layout.data_count - 8 * k)
        first = layout.data_start + 8 * k * layout.data_step
        step = layout.data_step
        take = compact_bytes if step == 2 else partial(spaced_bytes, step=step)
        per_window = max(1, (_WORD + step - 2) // step)
        word = np.zeros(len(rows), np.uint64)
        for done in range(0, count, per_window):
            window = _window(rows, width, first + done * layout.data_step + _WORD)
            word |= take(window, min(per_window, count - done)) << 8 * done
        return word


def _pieces(span: Span) -> list[Span]:
    """A field in parts of at most eight characters."""
    start, end = span
    return [(at, min(at + _WORD, end)) for at in range(start, end, _WORD)]


def _signed(word: bytes | bytearray) -> int:
    return int.from_bytes(word, "little", signed=True)


def _padded(length: int) -> int:
    return -(-length // _WORD) * _WORD


def _window(rows: NDArray[np.void], width: int, end: int) -> Words:
    """(n,) the eight characters of each line before position `end`."""
    return np.ndarray((len(rows),), "<u8", rows.data, end, (width,))


def regular_bytes(text: bytes, count: int) -> tuple[int, int]:
    """Where the first of `count` data bytes stands, and the step to the next; a step of 0 if irregular.

    >>> regular_bytes(b"  11  A2", 2), regular_bytes(b"0x11,0xA2", 2), regular_bytes(b"1 A2", 2)
    ((2, 4), (2, 5), (0, 0))
    """
    compact = text.strip()
    if count and len(compact) == 2 * count and _ROWS.fullmatch(compact):
        return text.index(compact), 2
    places = [found.start() for found in _BYTE.finditer(text)]
    if len(places) != count or not places:
        return 0, 0
    step = places[1] - places[0] if count > 1 else 3
    even = all(b - a == step for a, b in pairwise(places))
    return (places[0], step) if even and step <= MAX_DATA_STEP else (0, 0)


def lines_of(text: bytes) -> tuple[LineBatch, NDArray[np.intp]]:
    """The lines of a block, none of which is read yet, and (n,) the length of each."""
    raw = np.frombuffer(text, np.uint8)
    ends = np.flatnonzero(raw == 10)
    if text and text[-1] != 10:
        ends = np.append(ends, len(text))
    starts = np.concatenate((np.zeros(1, np.intp), ends[:-1] + 1)) if len(ends) else ends
    n = len(starts)
    batch = LineBatch(
        text,
        starts + _WORD,
        np.zeros(n, np.int64),
        np.zeros(n, np.uint8),
        np.zeros(n, np.uint32),
        np.zeros(n, np.uint16),
        np.zeros(n, np.uint8),
        np.zeros((n, 1), np.uint64),
        np.zeros(n, np.bool_),
        np.zeros(n, np.bool_),
    )
    return batch, ends - starts


def known_lines(
    text: bytes, matchers: Mapping[int, Sequence[LineMatcher]]
) -> tuple[LineBatch, NDArray[np.intp], list[int]] | None:
    """The same with the frames of all lines that a matcher of their length knows.

    They are tried in order, and those of lengths that occur count their `hits`; third the lengths
    that occur. None where the library cannot do it.
    """
    tried = [matcher for length in sorted(matchers) for matcher in matchers[length]]
    numbers = [matcher.numbers for matcher in tried]
    known = [each for each in numbers if each is not None]
    if not native.available() or len(known) < len(tried):
        return None
    sizes = np.array([len(each) for each in known], np.int64)
    lengths = np.array([matcher.length for matcher in tried], np.int64)
    layouts = np.fromiter(chain.from_iterable(known), np.int64, int(sizes.sum()))
    found = native.lines(text, layouts, np.cumsum(sizes) - sizes, lengths)
    for matcher, hits in zip(tried, found.hits.tolist(), strict=True):
        if found.of_length[matcher.length]:
            matcher.hits = hits
            matcher.idle = 0 if hits else matcher.idle + 1
    batch = LineBatch(
        text,
        found.starts + _WORD,
        found.t_ns,
        found.bus,
        found.can_id,
        found.flags,
        found.dlc,
        found.words,
        found.read,
        found.timed,
    )
    return batch, found.lengths, np.flatnonzero(found.of_length).tolist()
