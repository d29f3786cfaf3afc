"""Frames from serial adapters (slcan), read in bulk."""

import contextlib
import os
import re
import select
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from syncline_logger.adapter_clock import Knot
from syncline_logger.batcher import FrameBuffer
from syncline_logger.bus_options import BusOptions, Filter
from syncline_logger.clock import RecorderClock
from syncline_logger.source import SourceFacts
from syncline_logger.sources.damaged_lines import DamagedLines
from syncline_logger.sources.slcan_stamps import MILLISECOND_NS, StampClock
from syncline_logger.sources.slcan_wire import LineReader, Lines, Status, error_frame, status_of
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.can_errors import Controller, ErrorClass
from syncline_schemas.errors import MissingExtraError, SourceError

if TYPE_CHECKING:
    from serial import SerialBase

BITRATES = {
    10_000: "S0",
    20_000: "S1",
    50_000: "S2",
    83_300: "S9",
    100_000: "S3",
    125_000: "S4",
    250_000: "S5",
    500_000: "S6",
    750_000: "S7",
    800_000: "S7",
    1_000_000: "S8",
}
"""S7 is 800 kbit/s in LAWICEL's manual and 750 kbit/s in the firmware of some others."""
DATA_BITRATES = {500_000: "Y0", 1_000_000: "Y1", 2_000_000: "Y2", 4_000_000: "Y4",
                 5_000_000: "Y5", 8_000_000: "Y8"}  # fmt: skip
ARGUMENTS = frozenset({"tty_baudrate", "sleep_after_open", "rtscts", "listen_only", "timestamps"})
"""Further arguments that are known here; all but `timestamps` are python-can's."""

TTY_BAUDRATE = 115_200
WAKE_S = 2.0
"""An adapter that starts when its port is opened answers after so long at the latest."""
ANSWER_S = 0.25
COLLECT_NS = 20_000_000
"""Bytes are stamped as they come and parsed together."""
COLLECT_BYTES = 1 << 16
STATUS_NS = 1_000_000_000
"""An adapter that answers to `F` is asked so often for overruns."""
STATUS_TRY_NS = 30_000_000_000
"""One that never did is asked so often: an answer may have been damaged."""
CLOSED_AFTER = 2
"""An adapter that answered to `F` and refuses it so often in a row was reset."""
DEAD_AFTER = 5
"""One that gives nothing at all to so many `F` in a row is opened again."""
_READ_BYTES = 1 << 14
_ANSWER = re.compile(rb"(?:(?<=\r)|(?<=\a)|^)\n?\r|\a")
"""An empty line: the adapter took a command; BEL: it did not."""
_SHORTEST_BITS = {False: 47, True: 67}
"""Bits of the shortest frame and the pause after it, by whether its identifier is extended."""


class SlcanSource:
    """A bus behind a serial adapter; no command that sends a frame is ever written."""

    def __init__(self, options: BusOptions, clock: RecorderClock | None = None) -> None:
        self._options = options
        self._clock = clock or RecorderClock()
        self._port: SerialBase | None = None
        self._listens = False
        self._stamps: StampClock | None = None
        self._knots: deque[Knot] = deque()
        self._lines = LineReader()
        self._log_ns = 0
        self._just_opened = False
        self._status = Status(0)
        self._forget_answers()
        self._early = b""
        self._damage = DamagedLines()
        self.facts = SourceFacts(
            name=options.name,
            interface="slcan",
            channel=str(options.channel or ""),
            bitrate=options.bitrate,
            data_bitrate=options.data_bitrate if options.fd else None,
            fd=options.fd,
            clock="hardware" if self._with_stamps else "host",
            resolution_ns=MILLISECOND_NS if self._with_stamps else 1,
            filters=" ".join(f"{f['can_id']:X}:{f['can_mask']:X}" for f in options.filters),
        )

    @property
    def _with_stamps(self) -> bool:
        return bool(self._options.arguments.get("timestamps", False))

    def use_clock(self, clock: RecorderClock) -> None:
        """Stamp frames by this clock; before the source is opened."""
        self._clock = clock

    def clock_knots(self) -> list[Knot]:
        """How the adapter's stamps became t since the last call."""
        return [self._knots.popleft() for _ in range(len(self._knots))]

    def open(self) -> None:
        """Open the port and the adapter's channel. Raises SourceError, MissingExtraError."""
        if self._port is not None:
            return
        commands = self._settings()
        self._port = self._opened_port()
        self._lines, self._stamps, self._status = LineReader(), None, Status(0)
        try:
            notes = self._set_up(self._port, commands)
        except OSError as error:
            self.close()
            raise SourceError(self._what_failed("cannot open", error)) from error
        self._forget_answers()
        self._good_ns = self._clock.now_ns()
        self._just_opened = True
        self.facts = replace(self.facts, listen_only=self._listens, notes=notes)

    def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        """Put what has come into the buffer. Raises SourceError when the adapter is gone.

        timeout_s: 0 also tells the damage that is held back.
        """
        if self._port is None:
            raise SourceError(f"bus '{self.facts.name}' is not open")
        if self._just_opened:
            # What came since then is not earlier: before that is the gap.
            self._log_ns, self._just_opened = self._clock.now_ns(), False
        try:
            self._check_channel(buffer, bus)
            self._ask_status(self._port)
            pieces, times = self._collect(self._port, timeout_s)
        except SourceError:  # which is an OSError too
            self._damage.tell(buffer, bus)
            raise
        except OSError as error:
            self._damage.tell(buffer, bus)
            raise SourceError(self._what_failed("lost", error)) from error
        count = self.take(pieces, times, buffer, bus) if pieces else 0
        self._damage.tell(buffer, bus, self._clock.now_ns() if timeout_s else None)
        return count

    def take(
        self, pieces: Sequence[bytes], times: Sequence[int], buffer: FrameBuffer, bus: int
    ) -> int:
        """Put the frames of bytes into the buffer; how many.

        times: elapsed time at which each piece arrived [ns].
        """
        lines = self._lines.feed(b"".join(pieces))
        ends = np.array(list(accumulate(map(len, pieces))), np.int64)
        arrived = np.array(times, np.int64)
        log_ns = self._clock.now_ns()
        if lines.garbage_frames:
            # A line may have begun in the bytes before.
            begin_ns = times[0] + self._clock.offset_ns - COLLECT_NS
            begin_ns = min(max(self._log_ns, begin_ns), log_ns)
            self._damage.add(lines.garbage_frames, begin_ns, log_ns)
            self._damage.tell(buffer, bus, log_ns)
        self._note_answers(lines, log_ns)
        frames = self._stamped(lines, arrived[np.searchsorted(ends, lines.at, side="right")], bus)
        frames = self._with_errors(frames, lines, log_ns, bus)
        self._log_ns = log_ns
        if self._options.filters:
            frames = frames[_wanted(frames, self._options.filters)]
        if len(frames):
            buffer.extend(frames)
        return len(frames)

    def fileno(self) -> None:
        """None: bytes are stamped when they come, in a thread of their own."""

    def close(self) -> None:
        """Close the adapter's channel and the port; never raises."""
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(OSError):
                port.write(b"C\r")
            with contextlib.suppress(OSError):
                port.close()

    @property
    def _acknowledge(self) -> bool:
        return self._options.acknowledge or not self._options.arguments.get("listen_only", True)

    def _settings(self) -> list[str]:
        """The commands that set the bit rates."""
        for _, _, text in unknown_rates(self.facts):
            raise SourceError(f"bus '{self.facts.name}': {text}")
        return [commands[rate] for _, _, rate, commands in _rates(self.facts)]

    def _opened_port(self) -> "SerialBase":
        try:
            import serial
        except ImportError as error:
            raise MissingExtraError(
                "serial adapters need the package pyserial: pip install 'syncline[serial]'"
            ) from error
        path, _, rate = self.facts.channel.partition("@")
        arguments = self._options.arguments
        try:
            return serial.serial_for_url(
                path,
                baudrate=int(rate or arguments.get("tty_baudrate", TTY_BAUDRATE)),
                rtscts=bool(arguments.get("rtscts", False)),
                timeout=0,
                write_timeout=1,
                exclusive=True if os.name == "posix" else None,
            )
        except (OSError, ValueError) as error:
            raise SourceError(self._what_failed("cannot open", error)) from error

    def _set_up(self, port: "SerialBase", commands: list[str]) -> tuple[str, ...]:
        """Close the channel, set it, open it; what the user should know of it."""
        self._listens = not self._acknowledge
        wake_s = float(self._options.arguments.get("sleep_after_open", WAKE_S))
        answered = self._command(port, "C", wake_s)
        self._command(port, "C", ANSWER_S if answered is not None else 0)
        refused = [each for each in commands if self._command(port, each) is False]
        if self._with_stamps and self._command(port, "Z1") is False:
            refused.append("Z1")
        notes = [f"the adapter refused the command {command}" for command in refused]
        if self._acknowledge:
            self._command(port, "O", 0)
            return tuple(notes)
        if self._command(port, "L") is False:
            notes.append(self._open_otherwise(port))
        elif answered is None:
            notes.append("the adapter answers no command: whether it only listens is not known")
        return tuple(notes)

    def _open_otherwise(self, port: "SerialBase") -> str:
        """Open an adapter that knows no `L`; CANable 2 has a mode for it."""
        self._listens = bool(self._command(port, "M1"))
        self._command(port, "O")
        if self._listens:
            return "the adapter knows no command L: it was asked to be silent with M1"
        return "the adapter cannot only listen: it acknowledges the frames of others"

    def _command(self, port: "SerialBase", command: str, answer_s: float = ANSWER_S) -> bool | None:
        """Whether the adapter took a command; None when it did not say."""
        port.write(command.encode() + b"\r")
        end_ns = self._clock.elapsed_ns() + round(answer_s * 1e9)
        got = b""
        while (left_ns := end_ns - self._clock.elapsed_ns()) > 0:
            got += self._received(port, left_ns / 1e9)
            answer = _ANSWER.search(got)
            if answer:
                self._early = got[answer.end() :]
                return answer[0] != b"\a"
        self._early = got
        return None

    def _forget_answers(self) -> None:
        self._ask_at_ns = self._clock.elapsed_ns()
        self._answers_status = self._asked = False
        self._refusals = self._silences = 0
        self._good_ns = 0

    def _check_channel(self, buffer: FrameBuffer, bus: int) -> None:
        """Raise SourceError when the adapter's channel turned out to be closed."""
        if self._refusals >= CLOSED_AFTER or self._silences >= DEAD_AFTER:
            buffer.lose(bus, None, "closed", self._good_ns, self._clock.now_ns())
            raise SourceError(
                f"bus '{self.facts.name}' (slcan {self.facts.channel}): lost: "
                + ("the adapter was reset" if self._refusals else "the adapter answers no more")
            )

    def _ask_status(self, port: "SerialBase") -> None:
        """Ask for overruns."""
        now_ns = self._clock.elapsed_ns()
        if now_ns >= self._ask_at_ns:
            port.write(b"F\r")
            self._asked = True
            self._silences += self._answers_status
            self._ask_at_ns = now_ns + (STATUS_NS if self._answers_status else STATUS_TRY_NS)

    def _note_answers(self, lines: Lines, log_ns: int) -> None:
        """Whether the adapter still listens, by what it gave."""
        status = any(status_of(answer) is not None for _, answer in lines.answers)
        if status and not self._answers_status:
            self._ask_at_ns = self._clock.elapsed_ns() + STATUS_NS
        self._answers_status |= status
        self._silences = 0
        if status or len(lines.frames):
            self._refusals, self._good_ns = 0, log_ns
        elif lines.refused and self._asked and self._answers_status:
            self._refusals += 1
        self._asked &= not (status or lines.refused)

    def _collect(self, port: "SerialBase", timeout_s: float) -> tuple[list[bytes], list[int]]:
        """Bytes that come within the timeout, and until they are worth parsing; their times."""
        pieces, times = [], []
        data, self._early = self._early, b""
        data = data or self._received(port, timeout_s)
        begin_ns = now_ns = self._clock.elapsed_ns()
        size = 0
        while data:
            pieces.append(data)
            times.append(now_ns)
            size += len(data)
            left_ns = begin_ns + COLLECT_NS - now_ns
            if left_ns <= 0 or size >= COLLECT_BYTES or not timeout_s:
                break
            data = self._received(port, left_ns / 1e9)
            now_ns = self._clock.elapsed_ns()
        return pieces, times

    def _received(self, port: "SerialBase", timeout_s: float) -> bytes:
        """What is there, after waiting for it."""
        try:
            number = port.fileno() if os.name == "posix" else -1
        except OSError:  # io.UnsupportedOperation of ports that are no files
            number = -1
        if number >= 0:
            if not select.select([number], [], [], timeout_s)[0]:
                return b""
            data = os.read(number, _READ_BYTES)
            if not data:
                raise OSError("the adapter is gone")
            return data
        port.timeout = timeout_s
        data = bytes(port.read(1))
        return data + bytes(port.read(port.in_waiting)) if data else data

    def _stamped(self, lines: Lines, arrived_ns: NDArray[np.int64], bus: int) -> FrameBatch:
        frames = lines.frames
        if not len(frames):
            return frames
        t_ns = self._adapter_t_ns(lines, arrived_ns)
        if t_ns is None:
            t_ns = self._host_t_ns(frames, arrived_ns)
        return replace(frames, t_ns=t_ns, bus=np.full(len(frames), bus, np.uint8))

    def _adapter_t_ns(
        self, lines: Lines, arrived_ns: NDArray[np.int64]
    ) -> NDArray[np.int64] | None:
        """t by the adapter's clock; None where not all frames are stamped alike."""
        digits = int(lines.stamp_digits[0])
        if not digits or np.any(lines.stamp_digits != digits):
            return None
        if self._stamps is None or self._stamps.digits != digits:
            self._stamps = StampClock(self._clock, digits)
        cuts = np.flatnonzero(np.diff(arrived_ns)) + 1
        parts = []
        for begin, end in zip([0, *cuts], [*cuts, len(arrived_ns)], strict=True):
            part = self._stamps.t_ns(lines.stamp[begin:end], int(arrived_ns[begin]))
            if part is None:
                return None
            parts.append(part)
        self._knots += self._stamps.take_knots()
        return np.concatenate(parts)

    def _host_t_ns(self, frames: FrameBatch, arrived_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Arrival, and of frames that arrived together the latest times that the bus allows."""
        t_ns = arrived_ns + self._clock.offset_ns
        if self.facts.bitrate:
            extended = (frames.flags & FrameFlag.EXTENDED) != 0
            bits = np.where(extended, _SHORTEST_BITS[True], _SHORTEST_BITS[False])
            data_bits = np.where(frames.flags & (FrameFlag.REMOTE | FrameFlag.FD), 0, frames.dlc)
            passed_bits = np.cumsum(bits + 8 * data_bits.astype(np.int64))
            passed_ns = passed_bits * 1_000_000_000 // self.facts.bitrate
            latest = np.minimum.accumulate((t_ns - passed_ns)[::-1])[::-1]
            t_ns = latest + passed_ns
        return np.maximum(t_ns, self._log_ns)

    def _with_errors(self, frames: FrameBatch, lines: Lines, log_ns: int, bus: int) -> FrameBatch:
        """The frames, and what the adapter told of its controller as error frames."""
        errors = []
        for _, answer in lines.answers:
            status = status_of(answer)
            error = error_frame(answer) if status is None else self._status_error(status)
            if error:
                errors.append((log_ns, bus, error[0], int(FrameFlag.ERROR), 8, error[1]))
        if not errors:
            return frames
        return FrameBatch.concat([frames, FrameBatch.from_rows(errors)])

    def _status_error(self, status: Status) -> tuple[int, bytes] | None:
        """An error frame of a status that is news."""
        before, self._status = self._status, status
        bits = Controller(0)
        if status & (Status.OVERRUN | Status.RX_FULL):
            bits |= Controller.RX_OVERFLOW
        if (status ^ before) & (Status.PASSIVE | Status.WARNING):
            if status & Status.PASSIVE:
                bits |= Controller.RX_PASSIVE
            else:
                bits |= Controller.RX_WARNING if status & Status.WARNING else Controller.ACTIVE
        return (int(ErrorClass.CONTROLLER), bytes([0, bits, *bytes(6)])) if bits else None

    def _what_failed(self, what: str, error: Exception) -> str:
        reason = str(error).strip() or type(error).__name__
        return f"bus '{self.facts.name}' (slcan {self.facts.channel}): {what}: {reason}"


def unknown_rates(facts: SourceFacts) -> Iterator[tuple[str, int, str]]:
    """Option, bit rate and words for each rate that slcan has no command for."""
    for key, what, rate, commands in _rates(facts):
        if rate not in commands:
            known = ", ".join(map(str, commands))
            yield key, rate, f"slcan adapters know no {what} of {rate} bit/s; they know {known}"


def _rates(facts: SourceFacts) -> Iterator[tuple[str, str, int, Mapping[int, str]]]:
    if facts.bitrate is not None:
        yield "bitrate", "bit rate", facts.bitrate, BITRATES
    if facts.data_bitrate is not None:
        yield "data_bitrate", "data bit rate", facts.data_bitrate, DATA_BITRATES


def why_not_native(options: BusOptions) -> str:
    """What only python-can's slcan can do of these options; empty where nothing is."""
    unknown = [name for name in options.arguments if name not in ARGUMENTS]
    if unknown:
        return f"{', '.join(unknown)} of --bus-kwargs or --bus is known to it alone"
    return "--timing is known to it alone" if options.timing else ""


def _wanted(frames: FrameBatch, filters: tuple[Filter, ...]) -> NDArray[np.bool_]:
    """Frames that one of the filters takes, and all error frames."""
    wanted: NDArray[np.bool_] = (frames.flags & FrameFlag.ERROR) != 0
    for each in filters:
        inverted = bool(each["can_id"] & _INVERTED)
        mask = np.uint32(each["can_mask"] & 0x1FFF_FFFF)
        same = (frames.can_id & mask) == (np.uint32(each["can_id"] & 0x1FFF_FFFF) & mask)
        wanted |= same != inverted
    return wanted


_INVERTED = 0x2000_0000
"""SocketCAN's flag of a filter that takes all others (linux/can.h, CAN_INV_FILTER)."""
