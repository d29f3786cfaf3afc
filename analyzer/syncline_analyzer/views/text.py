"""Everything of an analysis as text for a terminal: findings first, then what they rest on."""

from collections.abc import Iterable, Iterator, Sequence
from io import StringIO
from itertools import groupby

from rich import box
from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from syncline_analyzer.results import Analysis, Finding, LatenessRow, PdoRow, SyncRow
from syncline_analyzer.views.basis import basis_lines, fine, stepped, trio, trio_ms
from syncline_analyzer.views.events import CLEARING, RESET, emcy_text
from syncline_analyzer.views.known import KnownLine, device_words, known_lines
from syncline_analyzer.views.lanes import cells, lanes_of
from syncline_analyzer.views.load import load_listing
from syncline_analyzer.views.markdown import chain_lines, extent, verdict, where
from syncline_analyzer.views.palette import SEVERITY_COLOURS, STATE_COLOURS, STATE_LETTERS, css
from syncline_analyzer.views.services import Listing, error_list, listings
from syncline_analyzer.views.terminal import (
    PIPE_WIDTH,
    SEVERITY_WORDS,
    start_lines,
    state_bar,
)
from syncline_analyzer.views.timing import error_control_listings
from syncline_analyzer.views.traces import trace_listings, trace_notes
from syncline_analyzer.views.waits import late_because, waiting_listings
from syncline_analyzer.views.words import (
    Clock,
    duration,
    frame_kinds,
    hex_code,
    names_of,
    node_label,
    number,
    object_name,
    printable,
    sdo_result,
    undrawn,
)

MAX_ROWS = 20
"""Rows of EMCY and failed SDO transfers; a note says how many there are in all."""

_WIDE = 110
"""Columns from which on tables show everything."""

_VERY_WIDE = 140
"""Columns from which on the traces have room for everything."""

_NARROW = 78
"""Columns below which figures have to be broken."""

_MEANT = (
    "jitter: standard deviation of the answers, else of single periods; device: medians of both"
    " bounds"
)
"""What columns of the table of SYNC and PDOs hold."""


def summary(analysis: Analysis, *, width: int = PIPE_WIDTH) -> str:
    """The summary as plain text without colours."""
    out = StringIO()
    print_summary(analysis, Console(file=out, width=width, color_system=None))
    return out.getvalue()


def print_summary(analysis: Analysis, console: Console) -> None:
    """Print the summary."""
    for part in _parts(analysis, console.width):
        console.print(part, highlight=False)


def _parts(analysis: Analysis, width: int) -> Iterator[RenderableType]:
    clock = Clock.of(analysis.capture)
    yield Text(extent(analysis), style="dim")
    yield from (line.coloured() for line in start_lines(analysis, clock))
    yield Text(verdict(analysis), style="bold")
    for place, finding in enumerate(analysis.findings, 1):
        yield from _story(place, finding, analysis, clock)
    for title, table in _tables(analysis, clock, width):
        yield Text()
        yield Text(title, style="bold underline")
        yield table


def _story(
    place: int, finding: Finding, analysis: Analysis, clock: Clock
) -> Iterator[RenderableType]:
    head = Text(f"\n{place} ")
    colour = css(SEVERITY_COLOURS[finding.severity])
    head.append(f"{SEVERITY_WORDS[finding.severity]} ", style=f"bold {colour}")
    head.append(printable(where(finding, names_of(analysis.nodes))), style="bold")
    stretch = clock.stretch(finding.start_ns, finding.end_ns)
    if clock.timed:
        head.append(f"  {stretch}")
    if " to " in stretch:
        head.append(f" ({duration(finding.end_ns - finding.start_ns)})", style="dim")
    yield head
    evidence = ", ".join(map(str, finding.evidence[:8]))
    more = f" and {len(finding.evidence) - 8} more" if len(finding.evidence) > 8 else ""
    body = Table.grid(padding=(0, 1))
    body.add_row("", Text(printable(finding.text)))
    for label, pieces in groupby(chain_lines(finding, clock), key=lambda piece: piece.label):
        for nth, piece in enumerate(pieces):
            body.add_row(Text("" if nth else label, style="dim"), Text(printable(piece.text)))
    body.add_row(Text("likely cause", style="dim"), Text(printable(finding.cause)))
    body.add_row(Text("check next", style="dim"), Text(printable(finding.check_next)))
    if finding.assumed:
        body.add_row(Text("assumed", style="dim"), Text(printable("; ".join(finding.assumed))))
    frames = f"frames {evidence}{more}" if evidence else "no single frame"
    body.add_row(Text("evidence", style="dim"), Text(f"{frames}  [{finding.id}]", style="dim"))
    yield Padding(body, (0, 0, 0, 2))


def _tables(analysis: Analysis, clock: Clock, width: int) -> Iterator[tuple[str, RenderableType]]:
    if analysis.nodes:
        yield "Nodes", _nodes(analysis, width)
    if analysis.nmt_states and clock.timed:
        yield "NMT states", _states(analysis, width)
    yield from _timing(analysis, clock, width)
    if analysis.emcy:
        messages = sum(row.transition != RESET for row in analysis.emcy)
        yield f"EMCY ({messages})", _emcy(analysis, clock)
    if history := error_list(analysis, analysis.error_history, clock, named=True):
        yield history.title, _listing(history)
    if analysis.sdo.failed:
        yield "SDO transfers that failed", _sdo(analysis, clock)
    yield from _measured(analysis, clock, width)
    if lines := known_lines(analysis):
        yield "What is known of the nodes, and from where", _known(analysis, lines)
    for listing in listings(analysis, clock):
        yield listing.title, _listing(listing)
    yield "Recording", _recording(analysis, clock)


def _grid(*heads: str, whole: bool = False) -> Table:
    """A table without a frame; a head that starts with ">" is of a column of figures.

    `whole` figures are never broken into two lines.
    """
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, collapse_padding=True)
    for head in heads:
        name = Text(head.removeprefix(">"))
        if head[0] == ">":
            table.add_column(name, justify="right", overflow="fold", no_wrap=whole)
        else:
            table.add_column(name, overflow="fold")
    return table


def _row(table: Table, *columns: object, style: str | None = None) -> None:
    table.add_row(*(c if isinstance(c, Text) else Text(str(c)) for c in columns), style=style)


def _nodes(analysis: Analysis, width: int) -> Table:
    heads = [
        "bus",
        "node",
        "state",
        ">boot-ups",
        ">EMCY",
        ">heartbeat",
        "SDO",
        "device",
        "known by",
    ]
    table = _grid(*heads[: 9 if width >= 110 else 8 if width >= 90 else 6])
    for row in analysis.nodes:
        alive = number(row.heartbeat_period_ms, "ms")
        if row.guard_answers or row.guard_requests:
            asked = f"/{row.guard_requests}" if row.guard_requests else ""
            alive = f"guarded {row.guard_answers}{asked}"
        sdo = str(row.sdo_transfers)
        for count, word in ((row.sdo_aborts, "aborted"), (row.sdo_unanswered, "unanswered")):
            sdo += f", {count} {word}" if count else ""
        state = Text(
            row.final_state, style=css(STATE_COLOURS.get(row.final_state, (158, 158, 158)))
        )
        label, device = node_label(row.node, row.name), device_words(row)
        shown = (
            row.bus,
            label,
            state,
            row.boot_ups,
            row.emcy,
            alive,
            sdo,
            device,
            ", ".join(row.proof),
        )
        _row(table, *shown[: len(table.columns)])
    return table


def _known(analysis: Analysis, lines: Sequence[KnownLine]) -> Table:
    table = Table.grid(padding=(0, 2))
    several = len(analysis.capture.buses) > 1
    names = names_of(analysis.nodes)
    before: tuple[str, int] | None = None
    for line in lines:
        key = line.bus, line.node
        bus = f"{line.bus} " if several and line.node else ""
        label = names.get(key, node_label(line.node))
        head = f"{bus}node {label}" if line.node and key != before else ""
        table.add_row(Text(head), Text(line.what, style="dim"), Text(line.text))
        before = key
    return table


def _states(analysis: Analysis, width: int) -> Group:
    capture = analysis.capture
    labels = names_of(analysis.nodes)
    several = len(capture.buses) > 1
    lanes = lanes_of(analysis)
    heads = {
        key: f"{key[0]} {labels.get(key, node_label(key[1]))}" if several
        else labels.get(key, node_label(key[1]))
        for key in lanes
    }  # fmt: skip
    room = max(10, width - min(max(map(len, heads.values())), width // 3) - 1)
    table = Table.grid(padding=(0, 1))
    table.add_column(
        min_width=width - room - 1, max_width=width // 3, overflow="ellipsis", no_wrap=True
    )
    table.add_column(no_wrap=True)
    for key, rows in lanes.items():
        table.add_row(
            Text(heads[key]),
            state_bar(cells(rows, capture.begin_ns, capture.end_ns, room)).coloured(),
        )
    legend = "  ".join(f"{letter} {state}" for state, letter in STATE_LETTERS.items())
    not_drawn = [Text(told)] if (told := undrawn(capture)) else []
    return Group(table, *not_drawn, Text(legend, style="dim"))


def _timing(analysis: Analysis, clock: Clock, width: int) -> Iterator[tuple[str, RenderableType]]:
    """Bus load, SYNC, PDOs and what they waited for: one screen, however many nodes there are."""
    one_bus = ("bus",) if len(analysis.capture.buses) < 2 else ()
    if analysis.bus_load:
        listing = load_listing(analysis, clock)
        yield listing.title, _narrowed(listing, ("of 10 ms", "longest busy"), width)
    if analysis.sync or analysis.pdos:
        notes = (Text(line, style="dim") for line in basis_lines(analysis))
        title = "SYNC and PDOs (min/median/max; period in ms, all else in us; waited: at most)"
        left = len(analysis.pdos) - MAX_ROWS
        rest = [Text(f"and {left} more PDOs with less to tell", style="dim")] if left > 0 else []
        meant = [Text(_MEANT, style="dim")] if width >= _WIDE else []
        yield title, Group(_pdos(analysis, one_bus, width), *rest, *meant, *notes)
    narrow = ("response", "device", "frames", "worst of", "count")
    for listing in (*waiting_listings(analysis, clock), *error_control_listings(analysis)):
        yield listing.title, _narrowed(listing, narrow, width, one_bus)


def _narrowed(
    listing: Listing, narrow: Sequence[str], width: int, always: Sequence[str] = ()
) -> Table:
    """The listing without some columns, always or where the screen is narrow."""
    hidden = {*always, *(narrow if width < _WIDE else ())}
    kept = [i for i, head in enumerate(listing.heads) if head.lstrip(">") not in hidden]
    rows = [[row[i] for i in kept] for row in listing.rows]
    return _listing(Listing(listing.title, [listing.heads[i] for i in kept], rows))


def _pdos(analysis: Analysis, one_bus: Sequence[str], width: int) -> Table:
    why = {(row.bus, row.cob_id): row for row in analysis.lateness}
    heads = ["bus", "COB-ID", "what", "type", ">frames", ">period", ">jitter", ">response", ">device", ">waited", "faults"]  # fmt: skip
    narrow = width < _WIDE
    hidden = {*one_bus, *(("type", "frames", "jitter", "device") if narrow else ())}
    kept = [i for i, head in enumerate(heads) if head.removeprefix(">") not in hidden]
    shown = _telling(analysis.pdos)
    rows = [_sync_cells(sync) for sync in analysis.sync]
    rows += [_pdo_cells(pdo, why.get((pdo.bus, pdo.cob_id))) for pdo in shown]
    table = _grid(*(heads[i] for i in kept), whole=width >= _NARROW)
    for row in rows:
        what = str(row[2]).removeprefix("node ") if narrow else row[2]
        cells = (*row[:2], what, *row[3:])
        _row(table, *(cells[i] for i in kept))
    return table


def _sync_cells(sync: SyncRow) -> tuple[object, ...]:
    step = sync.resolution_us
    return (
        sync.bus,
        hex_code(sync.cob_id, 3),
        "SYNC",
        "",
        sync.count,
        trio_ms(sync.period_us, step),
        fine(sync.jitter_us.std, step) if sync.jitter_us else "-",
        "",
        "",
        "",
        _sync_faults(sync),
    )


def _sync_faults(sync: SyncRow) -> Text:
    faults = _faults(missing=sync.missing, jumps=sync.counter_jumps, doubled=sync.doubled)
    if sync.drift_ppm is not None:
        faults.append(f" (drift {number(sync.drift_ppm, 'ppm', 3)})", style="dim")
    if sync.backlog:
        faults.append(f" ({sync.backlog} in a backlog, not judged)", style="dim")
    return faults


def _pdo_cells(pdo: PdoRow, why: LatenessRow | None) -> tuple[object, ...]:
    step = pdo.resolution_us
    what = f"node {pdo.node} {pdo.pdo or 'PDO'}" if pdo.node is not None else "PDO of nobody known"
    device = "-"
    if pdo.device_us_high is not None and (low := pdo.device_us_least or pdo.device_us_low):
        device = f"{stepped(low.median, step)}-{stepped(pdo.device_us_high.median, step)}"
    jitter = pdo.jitter_us or pdo.period_jitter_us
    others = _faults(extra=pdo.extra, soon=pdo.too_soon, unanswered=pdo.unanswered)
    faults = Text(late_because(pdo, why), style="bold red")
    if others.plain != "-":
        faults = Text(", ").join(part for part in (faults, others) if part.plain)
    return (
        pdo.bus,
        hex_code(pdo.cob_id, 3),
        what,
        _short_type(pdo),
        pdo.frames,
        trio_ms(pdo.period_us, step),
        fine(jitter.std, step) if jitter else "-",
        trio(pdo.response_us, step),
        device,
        "-" if pdo.waiting_us is None else stepped(pdo.waiting_us.max, step),
        faults if faults.plain else "-",
    )


def _short_type(pdo: PdoRow) -> str:
    """Transmission type in a word, with a question mark where it is only assumed or inferred."""
    if pdo.transmission_type is not None:
        sure = pdo.type_source in ("sdo-read", "sdo-write", "bus-description")
        return f"{pdo.transmission_type}{'' if sure else '?'}"
    inferred = pdo.type_source.removeprefix("inferred: ").split(",")[0]
    return "-" if inferred == "unknown" else f"{printable(inferred)}?"


def _telling(pdos: Sequence[PdoRow]) -> list[PdoRow]:
    """The PDOs that there is room for: those with faults, and those that answer most unevenly."""

    def rank(row: PdoRow) -> tuple[int, float]:
        faults = row.missed + row.late + row.extra + row.too_soon + row.unanswered
        answers = row.response_us
        return faults, answers.p99 - answers.min if answers else -1.0

    chosen = sorted(range(len(pdos)), key=lambda i: rank(pdos[i]), reverse=True)[:MAX_ROWS]
    return [pdos[i] for i in sorted(chosen)]


def pdo_type(pdo: PdoRow) -> str:
    """Transmission type of a PDO with where it is known from."""
    kind = "" if pdo.transmission_type is None else f"{pdo.transmission_type} "
    return f"{kind}({printable(pdo.type_source)})"


def _faults(**counts: int) -> Text:
    told = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    return Text(told or "-", style="bold red" if told else "")


def _emcy(analysis: Analysis, clock: Clock) -> Table:
    table = _grid("when", "bus", "node", "EMCY")
    labels = names_of(analysis.nodes)
    for row in analysis.emcy[:MAX_ROWS]:
        label = labels.get((row.bus, row.node), node_label(row.node))
        style = "green" if row.transition in CLEARING else None
        _row(table, clock.short(row.t_ns), row.bus, label, emcy_text(row), style=style)
    return _with_rest(table, len(analysis.emcy))


def _sdo(analysis: Analysis, clock: Clock) -> Table:
    table = _grid("when", "bus", "node", "object", "direction", "result")
    failed = analysis.sdo.failed
    for row in failed[:MAX_ROWS]:
        what = f"{object_name(row.index, row.sub)} {printable(row.name or '')}"
        asked = (clock.short(row.start_ns), row.bus, row.node, what, row.direction)
        _row(table, *asked, sdo_result(row))
    return _with_rest(table, len(failed))


def _with_rest(table: Table, count: int) -> Table:
    if count > MAX_ROWS:
        table.add_row(Text(f"and {count - MAX_ROWS} more", style="dim"))
    return table


def _measured(analysis: Analysis, clock: Clock, width: int) -> Iterator[tuple[str, RenderableType]]:
    """Traces, and what they and the devices tell of themselves."""
    one_bus = ("bus",) if len(analysis.capture.buses) < 2 else ()
    for listing in trace_listings(analysis, clock):
        hidden = (*one_bus, *(("samples",) if width < _VERY_WIDE else ()))
        table = _narrowed(listing, ("name", "samples by", "std [deg]", "reads"), width, hidden)
        for column in table.columns if width >= _WIDE else ():
            column.no_wrap = str(column.header) in ("node", "object", "name", "what")
        notes = trace_notes(analysis.traces) if listing.title == "Traces" else []
        yield listing.title, Group(table, *(Text(note, style="dim") for note in notes))


def _listing(listing: Listing) -> Table:
    table = _grid(*listing.heads)
    for row in listing.rows[:MAX_ROWS]:
        _row(table, *map(printable, row))
    return _with_rest(table, len(listing.rows))


def _recording(analysis: Analysis, clock: Clock) -> Table:
    table = Table.grid(padding=(0, 1))
    for line in recording_lines(analysis, clock):
        table.add_row(Text(printable(line)))
    return table


def recording_lines(analysis: Analysis, clock: Clock) -> Iterable[str]:
    """What is to be known of the capture itself: kinds of frames, holes, notes of the reader."""
    capture = analysis.capture
    yield f"frames: {frame_kinds(capture)}"
    yield from (f"damaged, read in part: {damage}" for damage in capture.damage)
    if capture.unparsed_lines:
        yield f"{capture.unparsed_lines:,} lines of the log could not be read"
    if clock.timed and capture.frames:
        yield f"resolution of the stamps: {duration(capture.resolution_ns)}"
    for gap in capture.gaps[:MAX_ROWS]:
        lost = "" if gap.lost_frames is None else f", {gap.lost_frames} frames lost"
        stretch = clock.stretch(gap.start_ns, gap.end_ns)
        yield f"blind {stretch} on {gap.bus or 'all buses'}: {gap.reason}{lost}"
    if len(capture.gaps) > MAX_ROWS:
        yield f"and {len(capture.gaps) - MAX_ROWS} more stretches in which the recorder was blind"
    for mark in capture.marks[:MAX_ROWS]:
        yield f"marked at {clock.short(mark.t_ns)}: {printable(mark.reason)}"
    if len(capture.marks) > MAX_ROWS:
        yield f"and {len(capture.marks) - MAX_ROWS} more marks"
    yield from capture.notes
