"""A session: captures opened as one, analyzed once, every table a DataFrame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from syncline_analyzer.capture import CaptureReader
from syncline_analyzer.engine import Progress, analyze
from syncline_analyzer.merge import Merge
from syncline_analyzer.moments import Moment, parse_moment
from syncline_analyzer.readers import open_capture
from syncline_analyzer.readers.mcap import McapReader
from syncline_analyzer.redaction import Redaction, Veil
from syncline_analyzer.results import Analysis
from syncline_analyzer.segments import in_segment_order
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import Device, load_device
from syncline_schemas.errors import UsageError

if TYPE_CHECKING:
    import pandas as pd

AnyPath = str | PathLike[str]


def open_session(
    captures: AnyPath | Sequence[AnyPath],
    *,
    description: AnyPath | BusDescription | None = None,
    devices: Mapping[int, str] | None = None,
    bitrate: int | None = None,
    data_bitrate: int | None = None,
    start: str | int | None = None,
    end: str | int | None = None,
) -> Session:
    """Open captures as one session; nothing is analyzed before the first question.

    Args:
        captures: one file or several of one machine, in any order.
        description: bus description (TOML); by default the one attached to the capture.
        devices: device name or EDS path by node id, for nodes the description leaves open.
        bitrate: bit/s of every bus whose bit rate is not told otherwise.
        data_bitrate: the same of the data phase of CAN FD frames.
        start, end: half-open range: "90s" into the capture, UTC as ISO text, or `t_ns`.

    Raises:
        CaptureError: a file is no capture that can be read.
        DescriptionError: the description or a device is unusable.
        UsageError: the captures cannot be put in order, or a time makes no sense.
    """
    paths = [captures] if isinstance(captures, (str, PathLike)) else list(captures)
    if not paths:
        raise UsageError("no capture given: name at least one file")
    if description is not None and not isinstance(description, BusDescription):
        description = BusDescription.load(Path(description))
    return Session(
        [Path(path) for path in paths],
        description,
        {node: load_device(name) for node, name in (devices or {}).items()},
        bitrate,
        _moment(start),
        _moment(end),
        data_bitrate,
    )


class Session:
    """Captures of one machine as one stretch of time, and everything they tell."""

    def __init__(
        self,
        paths: Sequence[Path],
        description: BusDescription | None,
        devices: Mapping[int, Device],
        bitrate: int | None,
        start: Moment | None,
        end: Moment | None,
        data_bitrate: int | None = None,
    ) -> None:
        self.paths = list(paths)
        self._description = description
        self._devices = dict(devices)
        self._bitrate = bitrate
        self._data_bitrate = data_bitrate
        self._start = start
        self._end = end
        self._analysis: Analysis | None = None

    def __repr__(self) -> str:
        files = ", ".join(path.name for path in self.paths)
        return f"<syncline session of {files}{'' if self._analysis else ', not analyzed yet'}>"

    def analyze(self, progress: Progress | None = None) -> Analysis:
        """Everything one pass over the captures tells; `progress` is called after each batch."""
        if self._analysis is None:
            readers = self._readers()
            merge = Merge(readers)
            self._check_range(readers)
            veil = Veil(Redaction.of_metadata(reader.facts.metadata for reader in readers))
            self._analysis = analyze(
                veil.over(self._stream(merge, readers)),
                [reader.facts for reader in readers],
                merge.buses,
                description=self._description_of(readers),
                devices=self._devices,
                bitrate=self._bitrate,
                data_bitrate=self._data_bitrate,
                origin_ns=merge.first_ns,
                progress=progress,
            )
            self._analysis = veil.lifted(self._analysis)
            if merge.first_ns is not None and not self._analysis.capture.frames:
                raise UsageError("no frame lies between --from and --to of these captures")
        return self._analysis

    @cached_property
    def analysis(self) -> Analysis:
        """Everything one pass over the captures tells."""
        return self.analyze()

    def frames(
        self, start: str | int | None = None, end: str | int | None = None
    ) -> Iterator[FrameBatch]:
        """Batches of the session, or of the half-open range given within it."""
        readers = self._readers()
        merge = Merge(readers)
        own, within = (self._start, self._end), (_moment(start), _moment(end))
        stretch = _stretch(merge, own).common(_stretch(merge, within))
        for _, item in _cut(_numbered(merge, readers, stretch), stretch):
            if isinstance(item, FrameBatch):
                yield item

    def findings(self) -> pd.DataFrame:
        """One row per finding, the worst first; `analysis.findings` holds them as dataclasses."""
        return self._frame("findings")

    def nodes(self) -> pd.DataFrame:
        """One row per node."""
        return self._frame("nodes")

    def nmt_states(self) -> pd.DataFrame:
        """One row per interval of a node's NMT state."""
        return self._frame("nmt_states")

    def nmt_commands(self) -> pd.DataFrame:
        """One row per NMT command."""
        return self._frame("nmt_commands")

    def sync(self) -> pd.DataFrame:
        """One row per SYNC identifier."""
        return self._frame("sync")

    def pdos(self) -> pd.DataFrame:
        """One row per PDO."""
        return self._frame("pdos")

    def pdo_responses(self, cob_id: int, bus: str | None = None) -> pd.DataFrame:
        """One row per answer of a synchronous PDO to its SYNC."""
        from syncline_analyzer.views.tables import responses_frame

        chosen = [
            responses
            for responses in self.analysis.responses
            if responses.cob_id == cob_id and bus in (None, responses.bus)
        ]
        return responses_frame(chosen, dated=self._dated)

    def emcy(self) -> pd.DataFrame:
        """One row per EMCY message."""
        return self._frame("emcy")

    def errors(self) -> pd.DataFrame:
        """One row per error of a node, from raise to clear."""
        return self._frame("errors")

    def emcy_context(self) -> pd.DataFrame:
        """What was around each EMCY: NMT state, bus state, SDO writes before it, measured values."""
        return self._frame("emcy_context")

    def error_history(self) -> pd.DataFrame:
        """One row per read of 1003h or 1001h, with the EMCY that told the same."""
        return self._frame("error_history")

    def sdo(self) -> pd.DataFrame:
        """One row per SDO transfer."""
        return self._frame("sdo")

    def objects(self, node: int, bus: str | None = None) -> pd.DataFrame:
        """What is known of a node's objects at the end, from where and since when.

        Objects that were seen on the bus, and the parameters that the analyses only assume (source
        "bus-description" or "eds-default").
        """
        return self._of_node("objects", node, bus)

    def object_history(self, node: int, bus: str | None = None) -> pd.DataFrame:
        """Every value of a node's objects with the stretch in which it held, by object and time."""
        return self._of_node("object_history", node, bus)

    def object_changes(self) -> pd.DataFrame:
        """Every change of a parameter: who made it, when, from what to what, in words."""
        return self._frame("object_changes")

    def device_health(self) -> pd.DataFrame:
        """What devices were asked of their state: EEPROM wear, hours, temperature, stored errors."""
        return self._frame("device_health")

    def traces(self) -> pd.DataFrame:
        """One row per sample of every trace."""
        from syncline_analyzer.views.tables import traces_frame

        return traces_frame(self.analysis.trace_data, dated=self._dated)

    def tilt(self, node: int, bus: str | None = None) -> pd.DataFrame:
        """One row per pose of an inclinometer: direction of gravity, angles by every definition.

        Where two angles do not tell a pose, `reason` says why and the columns are NaN.
        """
        from syncline_analyzer.views.tables import tilts_frame

        found = self.analysis.tilt_data
        chosen = [each for each in found if each.node == node and bus in (None, each.bus)]
        return tilts_frame(chosen, dated=self._dated)

    def tilts(self) -> pd.DataFrame:
        """One row per inclinometer and pair of its objects: how far it tilted."""
        return self._frame("tilts")

    def shafts(self) -> pd.DataFrame:
        """One row per two encoders that the bus description places on one shaft."""
        return self._frame("shafts")

    def followers(self) -> pd.DataFrame:
        """One row per two encoders that follow one another without being placed on one shaft."""
        return self._frame("followers")

    def bus_load(self) -> pd.DataFrame:
        """One row per bus."""
        return self._frame("bus_load")

    def bus_states(self) -> pd.DataFrame:
        """One row per interval of the state of the recorder's controller: active to bus-off."""
        return self._frame("bus_states")

    def bus_errors(self) -> pd.DataFrame:
        """One row per bus and kind of error frame, with how many there were."""
        return self._frame("bus_errors")

    def lss(self) -> pd.DataFrame:
        """One row per LSS frame."""
        return self._frame("lss")

    def time_stamps(self) -> pd.DataFrame:
        """TIME messages: the first one, then one a minute, and each one that jumps."""
        return self._frame("time_stamps")

    def bus_shares(self) -> pd.DataFrame:
        """One row per identifier: its share of the traffic and of the time."""
        return self._frame("bus_shares")

    def node_shares(self) -> pd.DataFrame:
        """One row per node: what all that it sends takes of the traffic and of the time."""
        return self._frame("node_shares")

    def error_control_periods(self) -> pd.DataFrame:
        """One row per node and kind: the rhythm of its heartbeat, or of the guard requests to it."""
        return self._frame("error_control_periods")

    def worst(self) -> pd.DataFrame:
        """The longest and shortest periods, responses and answers, each with its `seq`."""
        return self._frame("worst")

    def waits(self) -> pd.DataFrame:
        """The worst answers of each synchronous PDO, and the frames that went ahead of them."""
        return self._frame("waits")

    def delays(self) -> pd.DataFrame:
        """Whose frames synchronous PDOs waited for, and how long at most."""
        return self._frame("delays")

    def lateness(self) -> pd.DataFrame:
        """Why each synchronous PDO was late or missed: the bus, or its device."""
        return self._frame("lateness")

    def gaps(self) -> pd.DataFrame:
        """One row per stretch in which the recorder was blind."""
        from syncline_analyzer.views.tables import to_frame

        return to_frame(self.analysis.capture.gaps, "gaps", dated=self._dated)

    def _frame(self, table: str) -> pd.DataFrame:
        from syncline_analyzer.views.tables import to_frame

        return to_frame(getattr(self.analysis, table), table, dated=self._dated)

    def _of_node(self, table: str, node: int, bus: str | None) -> pd.DataFrame:
        from syncline_analyzer.views.tables import to_frame

        rows = getattr(self.analysis, table)
        chosen = [row for row in rows if row.node == node and bus in (None, row.bus)]
        return to_frame(chosen, table, dated=self._dated)

    def _check_range(self, readers: Sequence[CaptureReader]) -> None:
        """Raises: UsageError where the range cannot hold anything."""
        start, end = self._start, self._end
        if start and end and start.relative == end.relative and start.ns >= end.ns:
            raise UsageError("the range is empty: --from is not before --to")
        absolute = any(moment and not moment.relative for moment in (start, end))
        if absolute and any(reader.facts.time_base != "utc" for reader in readers):
            raise UsageError("these logs have no dates: write times as 90s or 1m30s into them")

    @property
    def _dated(self) -> bool:
        """Whether the stamps are UTC, so that they may be shown as dates."""
        return self.analysis.capture.start_utc_ns is not None

    def _readers(self) -> list[CaptureReader]:
        return in_segment_order([open_capture(path) for path in self.paths])

    def _description_of(self, readers: Sequence[CaptureReader]) -> BusDescription:
        """The user's description, else the one that the recorder attached to the capture."""
        if self._description is not None:
            return self._description
        for reader in readers:
            if reader.facts.description_toml:
                return BusDescription.loads(
                    reader.facts.description_toml, files=reader.facts.eds_files
                )
        return BusDescription()

    def _stream(self, merge: Merge, readers: Sequence[CaptureReader]) -> Iterator[Numbered]:
        stretch = _stretch(merge, (self._start, self._end))
        return _cut(_numbered(merge, readers, stretch), stretch)


Numbered = tuple[int, FrameBatch | Gap]
_EARLIEST_NS, _LATEST_NS = int(np.iinfo(np.int64).min), int(np.iinfo(np.int64).max)


@dataclass(frozen=True, slots=True)
class _Stretch:
    """The half-open stretch of time [low_ns, high_ns) that is wanted."""

    low_ns: int = _EARLIEST_NS
    high_ns: int = _LATEST_NS

    def common(self, other: _Stretch) -> _Stretch:
        """What lies in both."""
        return _Stretch(max(self.low_ns, other.low_ns), min(self.high_ns, other.high_ns))


_EVERYTHING = _Stretch()


def _moment(value: str | int | None) -> Moment | None:
    if value is None:
        return None
    return parse_moment(value) if isinstance(value, str) else Moment(value, relative=False)


def _stretch(merge: Merge, bounds: tuple[Moment | None, Moment | None]) -> _Stretch:
    origin_ns = merge.first_ns or 0
    start, end = bounds
    return _Stretch(
        start.resolved(origin_ns) if start else _EARLIEST_NS,
        end.resolved(origin_ns) if end else _LATEST_NS,
    )


def _numbered(
    merge: Merge, readers: Sequence[CaptureReader], stretch: _Stretch
) -> Iterator[Numbered]:
    """The merged stream with the place of each first frame; outside the stretch it may be wrong.

    Of our own captures only the chunks are read that the stretch needs.
    """
    skipped = _Skipped()
    for reader in readers if stretch != _EVERYTHING else ():
        if isinstance(reader, McapReader):
            reader.limit(stretch.low_ns, stretch.high_ns, skipped.add)
    seq = 0
    for item in merge.stream():
        yield seq + skipped.frames, item
        seq += len(item) if isinstance(item, FrameBatch) else 0


class _Skipped:
    """Counts the frames before a stretch that were not read."""

    def __init__(self) -> None:
        self.frames = 0

    def add(self, frames: int) -> None:
        """Count some more."""
        self.frames += frames


def _cut(stream: Iterator[Numbered], stretch: _Stretch) -> Iterator[Numbered]:
    """The rows within a stretch; `seq` stays the place in the whole capture."""
    if stretch == _EVERYTHING:
        yield from stream
        return
    for seq, item in stream:
        if isinstance(item, Gap):
            if item.start_ns < stretch.high_ns and item.end_ns > stretch.low_ns:
                yield seq, item
        else:
            inside = (item.t_ns >= stretch.low_ns) & (item.t_ns < stretch.high_ns)
            yield from _runs(seq, item, inside)


def _runs(seq: int, batch: FrameBatch, inside: np.ndarray) -> Iterator[Numbered]:
    """Unbroken runs of the chosen rows, so that each piece keeps its `seq`."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], inside, [False])).astype(np.int8)))
    for begin, stop in edges.reshape(-1, 2).tolist():
        yield seq + begin, batch[begin:stop]
