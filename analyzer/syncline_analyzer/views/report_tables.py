"""Tables of the report; each yields nothing where it would have no rows."""

from collections.abc import Iterator, Mapping, Sequence

from syncline_analyzer.results import (
    EmcyContextRow,
    EmcyRow,
    ErrorRow,
    NmtCommandRow,
    NmtStateRow,
    SdoRow,
)
from syncline_analyzer.views.html import Html, element, table
from syncline_analyzer.views.known import KnownLine
from syncline_analyzer.views.report_moment import Moments
from syncline_analyzer.views.services import Listing
from syncline_analyzer.views.words import (
    duration,
    hex_code,
    number,
    object_name,
    sdo_result,
)

_QUIET = ("active", "unknown")
MAX_ROWS = 200
"""Rows of a table of events; the parquet files hold all."""
OPEN_ROWS = 30
"""Tables of more rows open on a click."""


def limited(caption: str, heads: Sequence[str], rows: Sequence[Sequence[object]]) -> Iterator[Html]:
    """A table of the first 200 rows that says how many there are; nothing without rows.

    Of a long one only its name is seen until it is opened.
    """
    if not rows:
        return
    rest = len(rows) - MAX_ROWS
    told = f"{caption} (the first {MAX_ROWS} of {len(rows)})" if rest > 0 else caption
    whole = table(told, heads, rows[:MAX_ROWS])
    if len(rows) <= OPEN_ROWS:
        yield whole
    else:
        count = "" if rest > 0 else f": {len(rows)} rows"
        yield element("details", element("summary", f"{told}{count}"), whole, class_="long")


def state_table(rows: list[NmtStateRow], moments: Moments) -> Iterator[Html]:
    """Intervals of one node."""
    listed: list[Sequence[object]] = [
        (
            row.state,
            moments.when(row.start_ns, row.end_ns),
            duration(row.end_ns - row.start_ns) if moments.clock.timed else "-",
            row.certainty,
            "-" if row.evidence is None else row.evidence,
            row.cause,
        )
        for row in rows
    ]
    heads = ["State", "When", ">Duration", "Certainty", ">Frame", "Cause"]
    yield from limited("NMT states", heads, listed)


def command_table(
    rows: list[NmtCommandRow], labels: dict[tuple[str, int], str], moments: Moments
) -> Iterator[Html]:
    """NMT commands of all buses."""
    listed: list[Sequence[object]] = [
        (
            moments.when(row.t_ns),
            row.bus,
            row.command,
            labels.get((row.bus, row.node), "all" if row.node == 0 else row.node),
            number(row.confirmed_ms, "ms"),
            row.seq,
        )
        for row in rows
    ]
    heads = ["When", "Bus", "Command", "To node", ">Confirmed after", ">Frame"]
    yield from limited("NMT commands", heads, listed)


def listed_table(listing: Listing) -> Iterator[Html]:
    """A table that the text view shows as well."""
    heads = [
        f"{'>' * (h[0] == '>')}{h.lstrip('>')[:1].upper()}{h.lstrip('>')[1:]}"
        for h in listing.heads
    ]
    yield from limited(listing.title, heads, [*listing.rows])


def known_table(lines: Sequence[KnownLine]) -> Iterator[Html]:
    """Settings of one node and where they are known from, to be opened."""
    if lines:
        told = element("summary", "What is known of its settings, and from where")
        rows = [(line.what, line.text) for line in lines]
        yield element("details", told, table("Settings", ["What", "Value and source"], rows))


def _around(context: EmcyContextRow | None) -> str:
    """What else was known when an EMCY came: state, the last write before, measured values."""
    if context is None:
        return "-"
    sure = "" if context.certainty == "observed" else f" ({context.certainty})"
    told = [f"{context.state}{sure}"]
    if context.bus_state not in (None, *_QUIET):
        told.append(f"recorder's controller {context.bus_state}")
    told += [f"written: {text}" for text in context.writes[:1]]
    for value in list(context.values.values())[:3]:
        steps = (value["before"], value["after"])
        numbers = ", then ".join("?" if step is None else f"{step:.10g}" for step in steps)
        told.append(f"{value['name']} {numbers} {value['unit']}".rstrip())
    return "; ".join(told)


def emcy_table(
    rows: list[EmcyRow], contexts: Mapping[int, EmcyContextRow], moments: Moments
) -> Iterator[Html]:
    """EMCY messages of one node, each with what was around it."""
    listed: list[Sequence[object]] = [
        (
            moments.when(row.t_ns),
            element("code", hex_code(row.code)),
            row.transition,
            hex_code(row.error_register, 2),
            ", ".join(row.registers) or "-",
            element("code", row.manufacturer_hex or "-"),
            row.seq,
            element("div", _meaning(row), class_="wrap"),
            element("div", _around(contexts.get(row.seq)), class_="wrap"),
        )
        for row in rows
    ]
    heads = ["When", "Code", "Transition", "Register", "Bits", "Manufacturer bytes", ">Frame", "Meaning", "State, last write and values around it"]  # fmt: skip
    yield from limited("EMCY history", heads, listed)


def _meaning(row: EmcyRow) -> str:
    told = [row.meaning]
    for key, value in row.details.items():
        if value and not key.endswith("_bits"):
            bits = row.details.get(f"{key}_bits")
            told.append(f"{key} {value}" + (f" ({', '.join(bits)})" if bits else ""))
    return "; ".join(told)


def error_table(rows: list[ErrorRow], moments: Moments) -> Iterator[Html]:
    """Errors of one node from raise to clear."""
    listed: list[Sequence[object]] = [
        (
            element("code", hex_code(row.code)),
            row.status,
            moments.when(row.raised_ns),
            "-" if row.cleared_ns is None else moments.when(row.cleared_ns),
            row.count,
            row.meaning,
        )
        for row in rows
    ]
    heads = ["Code", "Status", "Raised", "Cleared", ">Messages", "Meaning"]
    yield from limited("Errors", heads, listed)


def sdo_table(rows: Sequence[SdoRow], moments: Moments) -> Iterator[Html]:
    """SDO transfers of one node."""
    listed: list[Sequence[object]] = [
        (
            moments.when(row.start_ns),
            element("code", object_name(row.index, row.sub)),
            row.direction,
            row.kind,
            sdo_result(row),
            number(row.answer_us, "us"),
            row.seq,
            row.name or "-",
        )
        for row in rows
    ]
    heads = ["When", "Object", "Direction", "Kind", "Result", ">Answer after", ">Frame", "Name"]
    yield from limited("SDO transfers that failed", heads, listed)
