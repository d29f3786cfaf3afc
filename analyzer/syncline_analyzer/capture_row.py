"""The row that tells of a capture as a whole: its frames, its gaps, and what reading it told."""

from collections.abc import Sequence

from syncline_analyzer.capture import CaptureFacts, time_base
from syncline_analyzer.census import Census
from syncline_analyzer.context import Context
from syncline_analyzer.results import CaptureRow, GapRow, MarkRow
from syncline_schemas.batch import Gap
from syncline_schemas.wording import counted


def capture_row(
    census: Census, facts: Sequence[CaptureFacts], context: Context, origin_ns: int | None
) -> CaptureRow:
    """What there is to tell of the whole capture, but for what the analyses add."""
    first_ns = census.first_ns or 0
    dated = time_base(facts) == "utc" and census.first_ns is not None
    stretches = [] if time_base(facts) == "none" else census.extent.stretches
    lasts_ns = census.latest_ns - first_ns if census.frames else 0
    if stretches:
        lasts_ns = sum(each.end_ns - each.start_ns for each in stretches)
    return CaptureRow(
        files=[str(each.path) for each in facts],
        frames=census.frames,
        data_frames=census.frames - census.remote - census.error,
        remote_frames=census.remote,
        error_frames=census.error,
        extended_frames=census.extended,
        unparsed_lines=sum(each.unparsed_count for each in facts),
        start_utc_ns=first_ns if dated else None,
        duration_ns=lasts_ns,
        buses=list(context.buses),
        gaps=[_gap_row(gap, context) for gap in census.gaps],
        first_ns=first_ns if origin_ns is None else origin_ns,
        cut_ns=census.first_ns if origin_ns not in (None, census.first_ns) else None,
        time_base=time_base(facts),
        resolution_ns=context.resolution_ns,
        notes=[note for each in facts for note in each.notes]
        + _strangers(context)
        + _fd_notes(census, context),
        damage=[f"{each.path}: {each.damage}" for each in facts if each.damage],
        marks=_marks(facts),
        remote_lost=any(each.remote_lost for each in facts),
        stretches=stretches,
    )


def _fd_notes(census: Census, context: Context) -> list[str]:
    return [
        f"CAN FD on {context.bus_name(bus)} ({counted(count, 'frame')}) counts as load only:"
        " CANopen FD is not read"
        for bus, count in sorted(census.fd.items())
        if count
    ]


def _marks(facts: Sequence[CaptureFacts]) -> list[MarkRow]:
    """What the recorder marked, in order of time."""
    rows = [
        MarkRow(each.t_ns, each.reason, _name(about.buses, each.bus), each.node)
        for about in facts
        for each in about.marks
    ]
    return sorted(rows, key=lambda row: row.t_ns)


def _name(buses: Sequence[str], number: int | None) -> str | None:
    return buses[number] if number is not None and number < len(buses) else None


def _strangers(context: Context) -> list[str]:
    """Buses that the description names and the capture does not hold: most likely a slip."""
    described = {
        *context.description.bitrates,
        *(bus for bus, _ in context.description.nodes if bus),
    }
    return [
        f"the bus description names {bus}, which is not in this capture"
        for bus in sorted(described - set(context.buses))
    ]


def _gap_row(gap: Gap, context: Context) -> GapRow:
    bus = None if gap.bus is None else context.bus_name(gap.bus)
    return GapRow(gap.start_ns, gap.end_ns, gap.reason, gap.lost_frames, bus)
