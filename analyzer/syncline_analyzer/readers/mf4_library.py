"""Frames out of ASAM MDF 4 files by way of asammdf; only the process that reads them imports this.

Source: ASAM MDF 4.1 "Bus logging"; channel groups named CAN_DataFrame, CAN_RemoteFrame and
CAN_ErrorFrame.
"""

import weakref
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.readers.mf4_chains import has_endless_chain
from syncline_analyzer.readers.mf4_values import values_at
from syncline_analyzer.readers.possible import possible
from syncline_analyzer.readers.resolution import Resolution
from syncline_analyzer.readers.times import FIRST_UTC_NS, SECOND_NS
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.errors import CaptureError

_RECORDS_AT_ONCE: Final = 1 << 17
_KINDS: Final = {
    "CAN_DataFrame": 0,
    "CAN_RemoteFrame": FrameFlag.REMOTE,
    "CAN_ErrorFrame": FrameFlag.ERROR,
}
_NEEDED: Final[dict[int, tuple[str, ...]]] = {
    0: ("ID", "DLC", "DataBytes"),
    FrameFlag.REMOTE: ("ID", "DLC"),
    FrameFlag.ERROR: (),
}
"""Fields without which records of a kind would be read as other frames than there were."""
_LENGTHS: Final = np.array([*range(9), 12, 16, 20, 24, 32, 48, 64], np.int64)
"""By DLC: data bytes."""
_MAX_BUSES: Final = 256
_MOST_BYTES: Final = 1 << 16
"""No record of a CAN frame is longer."""
_APART: Final = 1
"""Type of channels whose values are apart from the records, in which only their places stand."""
_DATA_BYTES: Final = 64
_VIRTUAL: Final = (3, 6)
"""Types of channels that have no bytes in the records."""
_LOCAL_TIME: Final = 1
"""Flag of the header block: its time is that of a clock on the wall."""
_LAST_NS: Final = 1 << 62
_MOST_S: Final = 2e9


def _library() -> Any:
    """asammdf's class for files of version 4, whose instances close without a word."""
    from asammdf.blocks.mdf_v4 import MDF4

    class Quiet(MDF4):  # type: ignore[misc, unused-ignore]
        """What a damaged file left half made cannot be closed either, and would tell so on stderr."""

        def close(self) -> None:
            with suppress(Exception):
                super().close()

    return Quiet


def _opened(path: Path, file: BinaryIO, library: Any) -> Any:
    """The file as asammdf opens it. Raises: CaptureError."""
    if file.read(12)[8:9] != b"4":
        raise CaptureError(f"{path}: is no ASAM MDF file of version 4, which alone can hold frames")
    file.seek(0)
    if has_endless_chain(file):
        raise CaptureError(
            f"{path}: a damaged ASAM MDF file: its blocks follow each other in a ring"
        )
    try:
        return library(file, __internal__=True, original_name=None, process_bus_logging=False)
    except Exception as error:  # noqa: BLE001  whatever a damaged file makes of asammdf
        # What is read may be a mended copy.
        problem = str(error).replace(file.name, path.name) or type(error).__name__
    raise CaptureError(f"{path}: cannot be read as ASAM MDF: {problem}")


def _fits(group: Any) -> bool:
    """Whether all fields lie within the records: asammdf reads whatever memory they point to."""
    size = int(group.channel_group.samples_byte_nr)
    whole = size + int(group.channel_group.invalidation_bytes_nr)
    return whole <= _MOST_BYTES and all(
        each.byte_offset + (each.bit_offset + each.bit_count + 7) // 8 <= size
        for each in group.channels
        if each.channel_type not in _VIRTUAL
    )


def _places_only(group: Any) -> dict[str, int]:
    """Let asammdf read only the places of values apart from the records, by number; their channels.

    The native code by which it reads the values themselves follows places and lengths wherever they lead.
    """
    apart = {}
    for number, channel in enumerate(group.channels):
        if channel.channel_type == _APART:
            channel.channel_type = channel.data_type = 0
            apart[str(channel.name)] = number
    return apart


def _closed(mdf: Any, file: BinaryIO) -> None:
    mdf.close()
    file.close()


class Mf4Frames:
    """The frames of all CAN groups, merged by their times.

    Args:
        readable: what is read; `path` is what it is called.

    Raises:
        CaptureError: the file cannot be read, or it holds no CAN frames.
    """

    def __init__(self, readable: Path, path: Path) -> None:
        self.facts = CaptureFacts(path, "mf4")
        library = _library()
        # What asammdf opens itself stays open where it fails.
        file = readable.open("rb")
        try:
            self._mdf: Any = _opened(path, file, library)
        except CaptureError:
            file.close()
            raise
        self._close = weakref.finalize(self, _closed, self._mdf, file)
        self._apart: dict[int, dict[str, int]] = {}
        self._outside = 0
        self._groups = list(self._can_groups())
        if not self._groups:
            why = f" that can be read: {self.facts.damage}" if self.facts.damage else ""
            raise CaptureError(f"{path}: an ASAM MDF file without recorded CAN frames{why}")
        header: Any = self._mdf.header
        start_ns = int(header.abs_time)
        self._start_ns = start_ns if FIRST_UTC_NS <= start_ns < _LAST_NS else 0
        self.facts.time_base = "utc" if self._start_ns else "relative"
        if self._start_ns and header.time_flags & _LOCAL_TIME:
            self.facts.notes.append("the log's date names no time zone; it is taken as UTC")
        self.facts.notes.append("times are numbers with a fraction in this format")

    def _can_groups(self) -> Iterator[tuple[int, str, int]]:
        """Index, name and number of records of each group of CAN frames."""
        for index, group in enumerate(self._mdf.groups):
            names = {channel.name for channel in group.channels}
            for kind in _KINDS:
                if kind not in names or not group.channel_group.cycles_nr:
                    continue
                if _fits(group):
                    self._apart[index] = _places_only(group)
                    yield index, kind, int(group.channel_group.cycles_nr)
                else:
                    self.facts.damage = f"the fields of {kind} lie outside of its records"

    def batches(self) -> Iterator[FrameBatch]:
        """Batches in order of time."""
        resolution = Resolution()
        pending = [FrameBatch.empty() for _ in self._groups]
        at = [0] * len(self._groups)
        while True:
            for number, (_, _, count) in enumerate(self._groups):
                if not len(pending[number]) and at[number] < count:
                    pending[number], at[number] = self._frames(number, at[number])
            filled = [each for each in pending if len(each)]
            if not filled:
                break
            # A group that is read to its end hides nothing more; the others may go on later.
            open_ends = [
                int(each.t_ns.max())
                for each, place, group in zip(pending, at, self._groups, strict=True)
                if len(each) and place < group[2]
            ]
            until_ns = min(open_ends, default=int(np.iinfo(np.int64).max))
            ready = FrameBatch.concat([each[each.t_ns <= until_ns] for each in filled])
            pending = [each[each.t_ns > until_ns] for each in pending]
            frames = ready[np.argsort(ready.t_ns, kind="stable")]
            resolution.sample(frames.t_ns, frames.bus, frames.can_id)
            self.facts.resolution_ns = resolution.step_ns
            yield possible(frames, self.facts)

    def _frames(self, number: int, at: int) -> tuple[FrameBatch, int]:
        """The frames of a group from a record on, and the record behind them."""
        index, name, count = self._groups[number]
        wanted = min(_RECORDS_AT_ONCE, count - at)
        try:
            signal = self._mdf.get(
                name, index, record_offset=at, record_count=_RECORDS_AT_ONCE, raw=True
            )
            seconds = np.nan_to_num(np.asarray(signal.timestamps, np.float64))
            stamps = np.rint(np.clip(seconds, -_MOST_S, _MOST_S) * SECOND_NS).astype(np.int64)
            fits, samples = self._complete(index, name, signal.samples)
            frames = self._batch(name, stamps + self._start_ns, samples)[fits]
        except Exception as error:  # noqa: BLE001  whatever a damaged file makes of asammdf
            self.facts.damage = f"the frames of {name} cannot be read: {error}"
            return FrameBatch.empty(), count
        if len(samples) < wanted:
            missing = count - at - len(samples)
            self.facts.damage = f"{missing} of {count} records of {name} are missing"
            return frames, count
        return frames, at + wanted

    def _complete(
        self, index: int, name: str, samples: NDArray[np.void]
    ) -> tuple[NDArray[np.bool_], NDArray[np.void]]:
        """Records with their data bytes where those are apart, and whether each has them."""
        fits, field = np.ones(len(samples), np.bool_), f"{name}.DataBytes"
        channel = self._apart[index].get(field)
        if channel is None or samples.ndim != 1 or field not in (samples.dtype.names or ()):
            return fits, samples
        places = samples[field].astype(np.uint64).reshape(len(samples))
        first, last = (int(places.min()), int(places.max())) if len(places) else (0, 0)
        group = self._mdf.groups[index]
        raw = self._mdf._load_signal_data(group=group, index=channel, offsets=(first, last))
        data, fits = values_at(raw, places - np.uint64(first), _DATA_BYTES)
        if outside := int(np.count_nonzero(~fits)):
            self._outside += outside
            self.facts.damage = f"the data bytes of {self._outside} frame(s) are missing"
        kind = [
            (each, samples.dtype[each])
            for each in samples.dtype.names or ()
            if each.startswith(f"{name}.") and each != field
        ]
        out = np.zeros(len(samples), [*kind, (field, np.uint8, (_DATA_BYTES,))])
        for each, _ in kind:
            out[each] = samples[each]
        out[field] = data
        return fits, out

    def _batch(self, name: str, t_ns: NDArray[np.int64], samples: NDArray[np.void]) -> FrameBatch:
        fields = samples.dtype.names or ()
        if samples.ndim != 1 or not fields:
            raise ValueError("its records have no fields")
        needed = _NEEDED[_KINDS[name]]
        if missing := [field for field in needed if f"{name}.{field}" not in fields]:
            raise ValueError(f"its records have no {' and no '.join(missing)}")

        def column(field: str) -> NDArray[np.int64]:
            wanted = f"{name}.{field}"
            if wanted not in fields:
                return np.zeros(len(samples), np.int64)
            values = samples[wanted]
            if values.dtype.kind in "SU":
                return np.isin(values, (b"Tx", "Tx")).astype(np.int64)
            return values.astype(np.int64)

        raw_id = column("ID")
        extended = (column("IDE") != 0) | (raw_id & 0x80000000 != 0)
        flags = np.full(len(samples), _KINDS[name], np.uint16)
        fd = column("EDL") != 0
        if _KINDS[name] == FrameFlag.ERROR:
            extended = fd = np.zeros(len(samples), np.bool_)
        for flag, given in (
            (FrameFlag.EXTENDED, extended),
            (FrameFlag.TX, column("Dir") != 0),
            (FrameFlag.FD, fd),
            (FrameFlag.BRS, fd & (column("BRS") != 0)),
            (FrameFlag.ESI, fd & (column("ESI") != 0)),
        ):
            flags |= np.where(given, flag, 0).astype(np.uint16)
        stated = column("DLC")
        if _KINDS[name] != FrameFlag.REMOTE:
            told = f"{name}.DataLength" in fields
            stated = column("DataLength") if told else _LENGTHS[np.clip(stated, 0, 15)]
        dlc = np.clip(stated, 0, 8 if _KINDS[name] == FrameFlag.REMOTE else 64)
        data = np.zeros((len(samples), 64 if bool(np.any(dlc > 8)) else 8), np.uint8)
        if f"{name}.DataBytes" in fields and _KINDS[name] != FrameFlag.REMOTE:
            found = samples[f"{name}.DataBytes"]
            if found.ndim != 2 or found.dtype != np.uint8:
                found = np.ascontiguousarray(found).view(np.uint8).reshape(len(samples), -1)
            width = min(data.shape[1], found.shape[1])
            data[:, :width] = found[:, :width]
            data[np.arange(data.shape[1]) >= dlc[:, np.newaxis]] = 0
        bus = self._buses(column("BusChannel"))
        if _KINDS[name] == FrameFlag.ERROR:
            # What the format calls the type of an error is no class of SocketCAN.
            self.facts.foreign_errors.update(self.facts.buses[number] for number in np.unique(bus))
        return FrameBatch(
            t_ns,
            bus,
            (raw_id & 0x1FFFFFFF).astype(np.uint32),
            flags,
            dlc.astype(np.uint8),
            data,
        )

    def _buses(self, channels: NDArray[np.int64]) -> NDArray[np.uint8]:
        out = np.zeros(len(channels), np.uint8)
        for channel in np.unique(channels).tolist():
            full = len(self.facts.buses) >= _MAX_BUSES
            out[channels == channel] = 255 if full else self.facts.bus_number(str(channel))
        return out
