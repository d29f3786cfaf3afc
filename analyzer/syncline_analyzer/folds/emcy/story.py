"""The error state machine of a node: what each EMCY does to its errors (CiA 301 7.2.7.2)."""

from bisect import bisect_right
from collections.abc import Sequence
from typing import Any, Literal

from syncline_analyzer.folds.emcy.reads import NoError
from syncline_analyzer.folds.nmt.table import BootUp
from syncline_analyzer.results import EmcyRow, ErrorRow
from syncline_schemas.canopen.emcy import EMCY_BYTES, short_message
from syncline_schemas.devices import Device, emcy_details, emcy_meaning, register_bits
from syncline_schemas.emcy_errors import (
    ActiveError,
    ErrorList,
    codes_told,
    codes_unexplained,
)
from syncline_schemas.named_tuples import NamedTuple

MAX_EVIDENCE = 50
MAX_LISTED = 32

Transition = Literal["raised", "further", "partly cleared", "all cleared", "reset", "malformed"]
_Ended = Literal["cleared", "lost at reset"]


class Message(NamedTuple):
    """A frame on a node's EMCY identifier."""

    seq: int
    t_ns: int
    data: bytes

    @property
    def whole(self) -> bool:
        """Whether it has the eight bytes of an EMCY."""
        return len(self.data) >= EMCY_BYTES


class Before(NamedTuple):
    """An EMCY whose bits tell of errors that no EMCY of the capture raised.

    `codes` are those that the device's table gives for the bits; empty where it has none.
    """

    seq: int
    codes: tuple[int, ...]


class Story:
    """Follows the errors of one node through its EMCYs and boot-ups.

    A read that says "no error" ends errors as well (`reads`), unless they are told again after it.

    Attributes:
        rows: one per message, and one per boot-up that takes errors with it.
        before: messages that tell of errors from before the capture; at most one per start.
    """

    def __init__(
        self, bus: str, node: int, device: Device | None, reads: Sequence[NoError] = ()
    ) -> None:
        self._reads = reads
        self._bus = bus
        self._node = node
        self._device = device
        self._errors = ErrorList(device)
        self._over: list[ErrorRow] = []
        self._listed: list[int] = []
        self._fresh_start = True
        self.rows: list[EmcyRow] = []
        self.before: list[Before] = []

    def tell(self, messages: Sequence[Message], boot_ups: Sequence[BootUp]) -> None:
        """Run through messages and boot-ups in order of `seq`."""
        events: list[tuple[int, Message | BootUp]] = [(m.seq, m) for m in messages]
        events += [(boot.seq, boot) for boot in boot_ups]
        for _, event in sorted(events, key=lambda entry: entry[0]):
            if isinstance(event, BootUp):
                self._boot_up(event)
            else:
                self._message(event)

    def errors(self) -> list[ErrorRow]:
        """All errors, also those that are still active."""
        left = []
        for error in self._errors.active:
            read = self._read_after(error, None)
            if read is None:
                left.append(self._row_of(error, None, "still active"))
            else:
                left.append(self._read_row(error, read))
        return self._over + left

    def _read_after(self, error: ActiveError, end_seq: int | None) -> NoError | None:
        """The first read after an error, and before a frame, that says that it is over."""
        first, last = error.evidence[0], error.evidence[-1]
        start = bisect_right(self._reads, last, key=lambda read: read.seq)
        for read in self._reads[start:]:
            if end_seq is not None and read.seq >= end_seq:
                return None
            if read.ends(first, last, error.register):
                return read
        return None

    def _read_row(self, error: ActiveError, read: NoError) -> ErrorRow:
        _note(error.evidence, read.seq)
        return self._row_of(error, read.t_ns, "cleared")

    def _message(self, message: Message) -> None:
        data = message.data
        if not message.whole:
            code = int.from_bytes(data[:2], "little") if len(data) >= 2 else None
            told = emcy_meaning(self._device, code) if code is not None else ""
            self._add(message, code, short_message(data, told), None, data[3:], "malformed")
            return
        code = int.from_bytes(data[:2], "little")
        transition = self._raise(message, code) if code >> 8 else self._clear(message)
        self._errors.remember(data)
        self._fresh_start = False
        meaning = emcy_meaning(self._device, code)
        self._add(message, code, meaning, data[2], data[3:8], transition)

    def _raise(self, message: Message, code: int) -> Transition:
        again = self._errors.ended_unseen(code, message.data)
        if again is not None and again.doubted is not None:
            seq, t_ns = again.doubted
            again.certain = True
            self._end([again], t_ns, seq, "cleared")
        transition: Transition = "further" if self._errors.active else "raised"
        error, fresh = self._errors.raised(code, message.data, message.t_ns)
        if error is not None:
            _note(error.evidence, message.seq)
        if error is None or fresh:
            self._list()
            self._note_before(message)
        return transition

    def _clear(self, message: Message) -> Transition:
        """A code 00xxh: what is left tells which errors it does not clear."""
        gone = self._errors.ended_by(message.data, (message.seq, message.t_ns))
        if gone is None:
            self._end(self._errors.active, message.t_ns, message.seq, "cleared")
            return "all cleared"
        if self._fresh_start and not self._errors.active:
            told = codes_told(self._device, message.data[2], message.data[3:8])
            self.before.append(Before(message.seq, told))
        self._end(gone, message.t_ns, message.seq, "cleared")
        if not self._fresh_start:
            self._note_before(message)
        return "partly cleared"

    def _note_before(self, message: Message) -> None:
        """Bits in an EMCY for which no error was raised: it came before the capture."""
        register, manufacturer = message.data[2], message.data[3:8]
        codes = codes_unexplained(self._device, self._errors.active, register, manufacturer)
        if codes and not self.before:
            self.before.append(Before(message.seq, codes))

    def _boot_up(self, boot: BootUp) -> None:
        self._errors.forget()
        if not self._errors.active or boot.repeated:
            return
        meaning = "boot-up: the error list is gone, which clears nothing"
        self._end(self._errors.active, boot.t_ns, boot.seq, "lost at reset")
        self._add(Message(boot.seq, boot.t_ns, b""), None, meaning, None, b"", "reset")

    def _end(self, errors: Sequence[ActiveError], t_ns: int, seq: int, status: _Ended) -> None:
        for error in list(errors):
            read = self._read_after(error, seq)
            if read is not None:
                self._over.append(self._read_row(error, read))
            else:
                _note(error.evidence, seq)
                self._over.append(self._row_of(error, t_ns, status))
            self._errors.active.remove(error)
        self._list()

    def _list(self) -> None:
        """Codes of what is active; rows between two changes share the list."""
        codes = dict.fromkeys(error.code for error in self._errors.active)
        self._listed = list(codes)[:MAX_LISTED]

    def _row_of(
        self, error: ActiveError, cleared_ns: int | None, status: _Ended | Literal["still active"]
    ) -> ErrorRow:
        return ErrorRow(
            self._bus,
            self._node,
            error.code,
            emcy_meaning(self._device, error.code),
            error.raised_ns,
            cleared_ns if status == "cleared" else None,
            status,
            error.count,
            list(error.evidence),
            error.certain,
        )

    def _add(
        self,
        message: Message,
        code: int | None,
        meaning: str,
        register: int | None,
        manufacturer: bytes,
        transition: Transition,
    ) -> None:
        whole: dict[str, Any] = {}
        if register is not None:
            whole = emcy_details(self._device, manufacturer)
        self.rows.append(
            EmcyRow(
                self._bus,
                self._node,
                message.seq,
                message.t_ns,
                code,
                meaning,
                register,
                register_bits(self._device, register) if register is not None else [],
                manufacturer.hex().upper(),
                transition,
                whole,
                self._listed,
            )
        )


def _note(evidence: list[int], seq: int) -> None:
    """Keep the first messages of an error and its last one."""
    if len(evidence) >= MAX_EVIDENCE:
        evidence.pop()
    evidence.append(seq)
