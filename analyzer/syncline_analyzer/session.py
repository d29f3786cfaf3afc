"""A session: captures opened as one, analyzed once, every table a DataFrame."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from syncline_analyzer.moments import Moment, parse_moment
from syncline_analyzer.reading_child import begun
from syncline_analyzer.reading_request import Request
from syncline_schemas.collecting import rare_collections, settled_objects
from syncline_schemas.errors import UsageError

# All else is imported when it is needed, so that a process that reads can start before it.
if TYPE_CHECKING:
    import pandas as pd

    from syncline_analyzer.capture import CaptureFacts, CaptureReader
    from syncline_analyzer.decode.stream import Decoding
    from syncline_analyzer.engine import Progress
    from syncline_analyzer.opened import Opened
    from syncline_analyzer.results import Analysis
    from syncline_schemas.batch import FrameBatch
    from syncline_schemas.description import BusDescription
    from syncline_schemas.devices import Device

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
    offsets: Mapping[str, str] | None = None,
    processes: Literal[1, 2] = 2,
) -> Session:
    """Open captures as one session; nothing is analyzed before the first question.

    Args:
        captures: one file or several of one machine, in any order.
        description: bus description (TOML); by default the one attached to the capture.
        devices: device name or EDS path by node id, for nodes the description leaves open.
        bitrate: bit/s of every bus whose bit rate is not told otherwise.
        data_bitrate: the same of the data phase of CAN FD frames.
        start, end: half-open range: "90s" into the capture, UTC as ISO text, or `t_ns`.
        offsets: by path or name of a file, how its times are moved: "+3600" or "-2.5" seconds, or
            the UTC time of its first frame as ISO text, which also gives a date to one that has none.
        processes: 2 lets another process read large captures while this one analyzes, where there
            are two processors; 1 does everything in this one, where many analyses run at once.

    Raises:
        CaptureError: a file is no capture that can be read.
        DescriptionError: the description or a device is unusable.
        UsageError: the captures cannot be put in order, or a time makes no sense.
    """
    paths = [captures] if isinstance(captures, (str, PathLike)) else list(captures)
    if not paths:
        raise UsageError("no capture given: name at least one file")
    return Session(
        [Path(path) for path in paths],
        _loaded(description),
        _devices(devices or {}),
        bitrate,
        _moment(start),
        _moment(end),
        data_bitrate,
        offsets,
        processes,
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
        offsets: Mapping[str, str] | None = None,
        processes: Literal[1, 2] = 2,
    ) -> None:
        self.paths = list(paths)
        self._offsets = dict(offsets or {})
        self._processes = processes
        self._description = description
        self._devices = dict(devices)
        self._bitrate = bitrate
        self._data_bitrate = data_bitrate
        self._start = start
        self._end = end
        self._analysis: Analysis | None = None

    def __repr__(self) -> str:
        if self._analysis is not None:
            return f"<syncline session of {repr(self._analysis).removeprefix('<analysis of ')}"
        files = ", ".join(path.name for path in self.paths)
        return f"<syncline session of {files}, not analyzed yet>"

    def _repr_html_(self) -> str:
        from syncline_analyzer.views.notebook import session_html

        return session_html(self.paths, self._analysis)

    def analyze(
        self, progress: Progress | None = None, meanwhile: Callable[[], object] | None = None
    ) -> Analysis:
        """Everything one pass over the captures tells.

        Args:
            progress: called after each batch.
            meanwhile: called while another process, if there is one, begins to read.
        """
        if self._analysis is None:
            self._analysis = self._analyzed(progress, meanwhile)
        return self._analysis

    def _analyzed(
        self, progress: Progress | None, meanwhile: Callable[[], object] | None
    ) -> Analysis:
        with rare_collections(), begun(self._request, self._processes) as opened:
            # Imported while another process begins to read.
            from syncline_analyzer.engine import analyze_prepared

            if meanwhile is not None:
                meanwhile()
            with settled_objects():
                reading = opened()
                analysis = analyze_prepared(
                    reading,
                    description=self._description_of(reading.facts),
                    devices=self._devices,
                    bitrate=self._bitrate,
                    data_bitrate=self._data_bitrate,
                    origin_ns=reading.origin_ns,
                    progress=progress,
                )
        limited = self._start is not None or self._end is not None
        if limited and reading.origin_ns is not None and not analysis.capture.frames:
            raise UsageError("no frame lies between --from and --to of these captures")
        return reading.veil.lifted(analysis)

    @cached_property
    def analysis(self) -> Analysis:
        """Everything one pass over the captures tells."""
        return self.analyze()

    def frames(
        self, start: str | int | None = None, end: str | int | None = None
    ) -> Iterator[FrameBatch]:
        """Batches of the session, or of the half-open range given within it."""
        from syncline_analyzer.reading import Captures
        from syncline_schemas.batch import FrameBatch

        captures = Captures(self.paths, self._offsets)
        own = captures.stretch(self._start, self._end)
        within = captures.stretch(_moment(start), _moment(end))
        for _, item in captures.numbered(own.common(within)):
            if isinstance(item, FrameBatch):
                yield item

    def opened(self) -> Opened:
        """The captures opened once more, for a pass over all frames from the first one on."""
        from syncline_analyzer.opened import Opened
        from syncline_analyzer.reading import EVERYTHING, Captures, check_range
        from syncline_analyzer.redaction import Redaction

        captures = Captures(self.paths, self._offsets)
        check_range(self._request, captures.facts)
        stretch = captures.stretch(self._start, self._end)
        return Opened(
            facts=captures.facts,
            buses=captures.buses,
            description=self._description_of(captures.facts),
            devices=self._devices,
            redaction=Redaction.of_metadata(each.metadata for each in captures.facts),
            first_ns=captures.first_ns,
            low_ns=stretch.low_ns,
            high_ns=stretch.high_ns,
            stream=captures.numbered(EVERYTHING),
        )

    def decoding(self) -> Decoding:
        """The frames of the session in words, for one pass."""
        from syncline_analyzer.decode.choice import Choice
        from syncline_analyzer.decode.stream import Decoding

        return Decoding(self.opened(), Choice())

    def opened_live(self, reader: CaptureReader) -> Opened:
        """A log that is still being written, for one pass over its frames as they come."""
        from syncline_analyzer.opened import Opened
        from syncline_analyzer.readers.live import numbered
        from syncline_analyzer.reading import EVERYTHING, Stretch, check_range
        from syncline_analyzer.redaction import Redaction

        first_ns, stream = numbered(reader.batches())
        facts, origin_ns = [reader.facts], first_ns or 0
        check_range(self._request, facts)
        stretch = Stretch(
            self._start.resolved(origin_ns) if self._start else EVERYTHING.low_ns,
            self._end.resolved(origin_ns) if self._end else EVERYTHING.high_ns,
        )
        return Opened(
            facts=facts,
            buses=reader.facts.buses,
            description=self._description_of(facts),
            devices=self._devices,
            redaction=Redaction(),
            first_ns=first_ns,
            low_ns=stretch.low_ns,
            high_ns=stretch.high_ns,
            stream=stream,
            live=True,
        )

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

    @property
    def _request(self) -> Request:
        return Request(self.paths, self._start, self._end, self._offsets)

    @property
    def _dated(self) -> bool:
        """Whether the stamps are UTC, so that they may be shown as dates."""
        return self.analysis.capture.start_utc_ns is not None

    def _description_of(self, facts: Sequence[CaptureFacts]) -> BusDescription:
        """The user's description, else the one that the recorder attached to the capture."""
        from syncline_schemas.description import BusDescription

        if self._description is not None:
            return self._description
        for each in facts:
            if each.description_toml:
                return BusDescription.loads(each.description_toml, files=each.eds_files)
        return BusDescription()


def _loaded(description: AnyPath | BusDescription | None) -> BusDescription | None:
    if not isinstance(description, (str, PathLike)):
        return description
    from syncline_schemas.description import BusDescription

    return BusDescription.load(Path(description))


def _devices(named: Mapping[int, str]) -> dict[int, Device]:
    if not named:
        return {}
    from syncline_schemas.devices import load_device

    return {node: load_device(name) for node, name in named.items()}


def _moment(value: str | int | None) -> Moment | None:
    if value is None:
        return None
    return parse_moment(value) if isinstance(value, str) else Moment(value, relative=False)
