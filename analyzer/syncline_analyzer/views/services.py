"""What the bus told besides nodes and PDOs, in rows for the text and HTML views alike."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby

from syncline_analyzer.results import (
    Analysis,
    BusStateRow,
    ErrorHistoryRow,
    ObjectChangeRow,
    TimeStampRow,
)
from syncline_analyzer.views.words import (
    Clock,
    duration,
    hex_code,
    names_of,
    node_label,
    object_name,
)
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.wording import counted

ERROR_LIST = 0x1003
_QUIET = ("active", "unknown")
BURST_NS = 1_000_000_000
"""Changes that follow one another so soon are made in one go [ns]."""
FEW = 3
"""More changes in one go than these are one line."""
_TOLD = ("sdo-read", "sdo-write", "bus-description", "before a reset", "unknown")
"""Sources of a value that somebody stated."""


class Listing(NamedTuple):
    """A table in words; a head that starts with ">" is of a column of figures."""

    title: str
    heads: list[str]
    rows: list[list[str]]


def listings(analysis: Analysis, clock: Clock) -> Iterator[Listing]:
    """Changes of parameters, error frames, states of the recorder's controller, LSS and TIME."""
    if analysis.object_changes:
        yield change_listing(analysis.object_changes, clock, named=True)
    errors = [
        [row.bus, str(row.count), clock.short(row.first_ns), clock.short(row.last_ns), row.kind]
        for row in analysis.bus_errors
    ]
    if errors:
        yield Listing("Error frames", ["bus", ">frames", "first", "last", "what they say"], errors)
    if clock.timed and (states := list(_bus_states(analysis.bus_states, clock))):
        heads = ["bus", "state", "from", ">lasts", ">tx errors", ">rx errors", "cause"]
        yield Listing("State of the recorder's controller", heads, states)
    if analysis.lss:
        lss = [[clock.short(row.t_ns), row.bus, row.sender, row.text] for row in analysis.lss]
        yield Listing(
            f"LSS ({counted(len(lss), 'frame')})", ["time", "bus", "from", "command"], lss
        )
    if analysis.time_stamps:
        heads = ["bus", "COB-ID", ">told of", "the first says", "at", ">ahead of the recorder"]
        yield Listing("TIME", heads, list(_time(analysis.time_stamps, clock)))


def change_listing(rows: Sequence[ObjectChangeRow], clock: Clock, *, named: bool) -> Listing:
    """Changes of parameters: when, what, from what, and who did it; `named` tells bus and node."""
    heads = ["time", "bus", "node", "change", "was", "object", "by", "saved"]
    changes = [_changes(group, clock) for group in _bursts(rows, clock)]
    if not named:
        heads, changes = [heads[0], *heads[3:]], [[row[0], *row[3:]] for row in changes]
    return Listing(f"Changes of parameters ({len(rows)})", heads, changes)


def _bursts(rows: Sequence[ObjectChangeRow], clock: Clock) -> list[list[ObjectChangeRow]]:
    """Changes one by one; those that a client or a reset made in one go together."""
    groups: list[list[ObjectChangeRow]] = []
    last: dict[tuple[str, int | None, str], list[ObjectChangeRow]] = {}
    for row in rows:
        key = row.bus, row.node, row.who
        group = last.get(key)
        if group and clock.timed and 0 <= row.t_ns - group[-1].t_ns <= BURST_NS:
            group.append(row)
        else:
            last[key] = [row]
            groups.append(last[key])
    parts = [[group] if len(group) > FEW else [[row] for row in group] for group in groups]
    return sorted((part for each in parts for part in each), key=lambda part: part[0].seq)


def _changes(rows: Sequence[ObjectChangeRow], clock: Clock) -> list[str]:
    """One change, or several that were made in one go."""
    first = _change(rows[0], clock)
    if len(rows) == 1:
        return first
    words = ", ".join(row.words for row in rows[:FEW])
    more = f" and {len(rows) - FEW} more"
    saved = {row.saved for row in rows} - {None}
    told = (
        "-" if not saved else "yes" if saved == {True} else "no" if saved == {False} else "in part"
    )
    return [*first[:3], words + more, "-", counted(len(rows), "object"), first[6], told]


def _change(row: ObjectChangeRow, clock: Clock) -> list[str]:
    """One change of a parameter."""
    was = f"{row.old_words or '-'}{'' if row.old_source in _TOLD else ' (assumed)'}"
    again = f" (again {counted(row.repeats, 'time')})" if row.repeats else ""
    return [
        clock.short(row.t_ns),
        row.bus,
        node_label(row.node),
        row.words + again,
        was,
        object_name(row.index, row.sub) if row.index is not None else "-",
        row.who,
        {True: "yes", False: "no", None: "-"}[row.saved],
    ]


def _bus_states(rows: Iterable[BusStateRow], clock: Clock) -> Iterator[list[str]]:
    """States of the buses on which the controller was ever anything but error-active."""
    for _, group in groupby(rows, key=lambda row: row.bus):
        found = list(group)
        if all(row.state in _QUIET for row in found):
            continue
        for row in found:
            counters = ("-" if n is None else str(n) for n in (row.tx_errors, row.rx_errors))
            lasts = duration(row.end_ns - row.start_ns)
            yield [row.bus, row.state, clock.short(row.start_ns), lasts, *counters, row.cause]


def _time(rows: Iterable[TimeStampRow], clock: Clock) -> Iterator[list[str]]:
    """One line per TIME identifier."""
    ordered = sorted(rows, key=lambda row: (row.bus, row.cob_id))
    for (bus, cob_id), group in groupby(ordered, key=lambda row: (row.bus, row.cob_id)):
        found = list(group)
        offsets = [row.offset_ns for row in found if row.offset_ns is not None]
        ahead = "-"
        if offsets:
            low, high = duration(min(offsets)), duration(max(offsets))
            ahead = low if low == high else f"{low} to {high}"
        first = found[0]
        yield [
            bus,
            hex_code(cob_id, 3),
            str(len(found)),
            first.text,
            clock.short(first.t_ns),
            ahead,
        ]


def error_list(
    analysis: Analysis, rows: Iterable[ErrorHistoryRow], clock: Clock, *, named: bool
) -> Listing | None:
    """Reads of 1003h and 1001h that tell something, with what the bus had told of it.

    `named` puts bus and node in front.
    """
    labels = names_of(analysis.nodes)
    told = [
        [
            clock.short(row.t_ns),
            *([row.bus, labels.get((row.bus, row.node), str(row.node))] if named else []),
            object_name(row.index, row.sub),
            f"{row.meaning} ({hex_code(row.code)})" if row.code else row.meaning,
            f"EMCY, frame {row.emcy_seq}" if row.seen == "seen" else row.seen,
            row.note,
        ]
        for row in rows
        if row.seen != "empty" and (row.index == ERROR_LIST or row.raw or row.note)
    ]
    heads = ["read at", *(["bus", "node"] if named else []), "object", "holds", "seen as", "note"]
    return Listing("Error list 1003h and register 1001h", heads, told) if told else None
