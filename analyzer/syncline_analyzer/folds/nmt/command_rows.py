"""Rows of NMT commands: what was told to whom, and how long it took until it was confirmed."""

from collections.abc import Mapping

from syncline_analyzer.context import Context
from syncline_analyzer.folds.nmt.commands import Commands
from syncline_analyzer.folds.nmt.events import Command
from syncline_analyzer.folds.nmt.measures import Measures
from syncline_analyzer.folds.nmt.table import NodeKey
from syncline_analyzer.results import NmtCommandRow
from syncline_schemas.canopen.nmt import command_name


def command_rows(
    context: Context, commands: Commands, measures: Mapping[NodeKey, Measures]
) -> list[NmtCommandRow]:
    """One row per command in order of `seq`."""
    rows = [
        _row(context, bus, command, measures)
        for bus, told in sorted(commands.by_bus.items())
        for command in told
    ]
    return sorted(rows, key=lambda row: row.seq)


def _row(
    context: Context, bus: int, command: Command, measures: Mapping[NodeKey, Measures]
) -> NmtCommandRow:
    if command.node:
        node = measures.get((bus, command.node))
        confirmed = node.confirmed(command) if node else None
    else:
        confirmed = _broadcast_confirmed(bus, command, measures)
    timed = context.timed and confirmed is not None
    return NmtCommandRow(
        context.bus_name(bus),
        command.seq,
        command.t_ns,
        command_name(command.specifier),
        command.node,
        (confirmed or 0) / 1e6 if timed else None,
    )


def _broadcast_confirmed(
    bus: int, command: Command, measures: Mapping[NodeKey, Measures]
) -> int | None:
    """Time until the last node of the bus confirmed; None when one of them did not."""
    times = [
        node.confirmed(command)
        for (on, _), node in measures.items()
        if on == bus and node.listens(command)
    ]
    told = [time for time in times if time is not None]
    return max(told) if told and len(told) == len(times) else None
