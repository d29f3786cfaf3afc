"""What the live view shows, as columns into a Rerun viewer or file."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import rerun as rr  # noqa: TID251  only the live view's own process imports this module
import rerun.blueprint as rrb  # noqa: TID251
from numpy.typing import NDArray
from rerun.blueprint.encodings import TimelineColumn  # noqa: TID251

from syncline_logger.live_view.scene import LogRow, Node, Shown, SignalRows
from syncline_schemas.canopen.nmt import NmtState

APPLICATION = "syncline live"
_COLOURS = {
    NmtState.INITIALISING: 0xAB82FFFF,
    NmtState.PRE_OPERATIONAL: 0xFFC107FF,
    NmtState.OPERATIONAL: 0x43A047FF,
    NmtState.STOPPED: 0x1E88E5FF,
    NmtState.LOST: 0xE53935FF,
    NmtState.UNKNOWN: 0x9E9E9EFF,
}
"""The same as in the views of the analyzer."""
_LINES = (0x50A0FFFF, 0xFFA03CFF, 0x5AC878FF, 0xC878FFFF, 0xF0DC50FF, 0x3CD2DCFF, 0xFF82AAFF,
          0xAABE5AFF)  # fmt: skip
"""Colours of lines in turn; those that the viewer chooses are often alike."""
_PLAIN = "no unit"
MAX_PLOTS = 4
"""Plots of values, one per unit; the units that come later are not shown."""


class ViewerSink:
    """Sends what is new.

    Args:
        target: address of a viewer ("rerun+http://127.0.0.1:9876/proxy"), or a file to write.
        start_ns: when the recording began.
    """

    def __init__(self, target: str, start_ns: int) -> None:
        self._start_ns = start_ns
        self._stream = rr.RecordingStream(APPLICATION, send_properties=False)
        self._stream.set_log_time_enabled(False)
        self._units: list[str] = []
        self._declared: set[str] = set()
        self._lines = 0
        if "://" in target:
            self._stream.connect_grpc(target, default_blueprint=self._layout())
        else:
            self._stream.save(Path(target), default_blueprint=self._layout())

    def show(self, shown: Shown) -> None:
        """Send it, without waiting for it to arrive."""
        for state in shown.states:
            entity = _entity("nmt", state.node)
            if self._first(entity):
                names = list(_COLOURS)
                self._stream.log(
                    entity,
                    rr.StateConfiguration(
                        values=names, labels=names, colors=list(_COLOURS.values())
                    ),
                    static=True,
                )
            self._send(entity, [state.t_ns], rr.StateChange.columns(state=[state.state]))
        self._log(shown.log)
        for signal in shown.signals:
            self._signal(signal)
        for load in shown.loads:
            entity = rr.new_entity_path(["load", load.bus])
            self._line(entity, f"{load.bus} [%]")
            self._send(entity, [load.t_ns], rr.Scalars.columns(scalars=[load.percent]))

    def close(self) -> None:
        """Send the rest."""
        self._stream.flush(timeout_sec=2.0)
        self._stream.disconnect()

    def _log(self, rows: list[LogRow]) -> None:
        if rows:
            columns = rr.TextLog.columns(
                text=[f"{self._moment(row.t_ns)}  {row.text}" for row in rows],
                level=[row.level for row in rows],
            )
            self._send("log", [row.t_ns for row in rows], columns)

    def _moment(self, t_ns: int) -> str:
        """Time since the start; the viewer's own column of it would be cut short."""
        seconds, ms = divmod((t_ns - self._start_ns) // 1_000_000, 1000)
        minutes, seconds = divmod(seconds, 60)
        hours, minutes = divmod(minutes, 60)
        return f"{hours}:{minutes:02}:{seconds:02}.{ms:03}"

    def _signal(self, signal: SignalRows) -> None:
        unit = signal.unit or _PLAIN
        entity = _entity("values", signal.node, unit, signal.name)
        if unit not in self._units:
            self._units.append(unit)
            self._stream.send_blueprint(self._layout())
        self._line(
            entity, f"{signal.node.label}: {signal.name} [{signal.unit}]".removesuffix(" []")
        )
        known = np.isfinite(signal.values)
        values = signal.values[known]
        self._send(entity, signal.t_ns[known], rr.Scalars.columns(scalars=values))

    def _line(self, entity: str, name: str) -> None:
        if self._first(entity):
            colour = _LINES[self._lines % len(_LINES)]
            self._lines += 1
            what = rr.SeriesLines(names=name, colors=colour, aggregation_policy="MinMax")
            self._stream.log(entity, what, static=True)

    def _first(self, entity: str) -> bool:
        first = entity not in self._declared
        self._declared.add(entity)
        return first

    def _send(
        self, entity: str, t_ns: Iterable[int] | NDArray[np.int64], columns: rr.ComponentColumnList
    ) -> None:
        stamps = np.asarray(t_ns, np.int64)
        since = (stamps - self._start_ns).view("timedelta64[ns]")
        times = [
            rr.TimeColumn("capture", duration=since),
            rr.TimeColumn("utc", timestamp=stamps.view("datetime64[ns]")),
        ]
        self._stream.send_columns(entity, indexes=times, columns=columns)

    def _layout(self) -> rrb.Blueprint:
        plots = [
            rrb.TimeSeriesView(origin=rr.new_entity_path(["values", unit]), name=unit)
            for unit in self._units[:MAX_PLOTS]
        ]
        return rrb.Blueprint(
            rrb.Horizontal(
                rrb.Vertical(
                    rrb.StateTimelineView(origin="/nmt", name="NMT states"),
                    *plots,
                    rrb.TimeSeriesView(origin="/load", name="Bus load"),
                    row_shares=[3, *[2] * len(plots), 1],
                ),
                rrb.TextLogView(
                    origin="/log",
                    name="EMCY, commands, lost nodes",
                    columns=rrb.TextLogColumns(
                        timeline_columns=[TimelineColumn("capture", visible=False)],
                        text_log_columns=["LogLevel", "Body"],
                    ),
                ),
                column_shares=[5, 3],
            ),
            rrb.TimePanel(timeline="capture", state="collapsed", play_state="following"),
            rrb.BlueprintPanel(state="collapsed"),
            rrb.SelectionPanel(state="collapsed"),
            auto_views=False,
        )


def _entity(root: str, node: Node, *between_and_name: str) -> str:
    """Path of what belongs to a node; names of any characters."""
    between, name = between_and_name[:-1], between_and_name[-1:]
    return rr.new_entity_path([root, *between, node.bus, node.label.replace(" ", "_"), *name])
