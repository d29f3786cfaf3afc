"""The analysis on one screen: what happened, the states of the nodes, how full the buses are."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import IO, TYPE_CHECKING

from syncline_analyzer.redaction import Redaction
from syncline_analyzer.results import Analysis, Finding, SyncRow
from syncline_analyzer.views.lanes import Lanes, cells, lanes_of
from syncline_analyzer.views.line import Line, broken, columns, fitted
from syncline_analyzer.views.load import bit_rate
from syncline_analyzer.views.markdown import extent, verdict
from syncline_analyzer.views.palette import SEVERITY_COLOURS, STATE_LETTERS, css
from syncline_analyzer.views.terminal import (
    PIPE_WIDTH,
    SEVERITY_WORDS,
    console_for,
    is_plain,
    start_lines,
    state_bar,
)
from syncline_analyzer.views.troubled import troubled
from syncline_analyzer.views.words import (
    Clock,
    duration,
    hex_code,
    names_of,
    node_label,
    number,
    printable,
    undrawn,
)
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.wording import counted

if TYPE_CHECKING:
    from rich.console import Console

FEWEST, MOST = 24, 40
"""Lines of a screen, whatever the terminal says."""
MOST_LANES = 12
_LEAST_LANES = 3
_LABEL_WIDTH = 22
_ELLIPSIS = " ..."


class Shape(NamedTuple):
    """How much is told of each finding: lines of its text (None: all), and what to check next."""

    lines: int | None
    check: bool


WHOLE = Shape(None, True), Shape(None, False)
SHORT = Shape(2, False), Shape(1, False)


def screen(analysis: Analysis, *, width: int, height: int = MOST, whole_texts: bool = True) -> str:
    """The screen as plain text without colours."""
    lines = _lines(analysis, width, height, whole_texts=whole_texts)
    texts = [line.plain for line in lines]
    shown = [fitted(text, width) if columns(text) > width else text for text in texts]
    return "".join(f"{text}\n" for text in shown)


def write_screen(analysis: Analysis, stream: IO[str]) -> None:
    """Write what fits on one screen to a stream: colours and shortened texts to a terminal only."""
    if is_plain(stream):
        stream.write(screen(analysis, width=PIPE_WIDTH))
        stream.flush()
    else:
        print_screen(analysis, console_for(stream))


def print_screen(analysis: Analysis, console: "Console") -> None:
    """Print what fits on one screen; texts are shortened on a terminal only."""
    height = console.height - 1 if console.is_terminal else MOST
    whole = not console.is_terminal
    for line in _lines(analysis, console.width, height, whole_texts=whole):
        console.print(line.coloured(), highlight=False, no_wrap=True, crop=False)


def _lines(analysis: Analysis, width: int, height: int, *, whole_texts: bool) -> list[Line]:
    """All lines, none wider than the screen."""
    clock = Clock.of(analysis.capture)
    budget = min(max(height, FEWEST), MOST)
    lanes = lanes_of(analysis) if clock.timed else {}
    middle = [Line()] * bool(lanes or analysis.findings)
    top = [*_top(analysis, clock, width), Line()]
    bottom = [*middle, *_bottom(analysis, clock, width)]
    legend = list(_legend(lanes, width)) if lanes else []
    least = min(len(lanes), _LEAST_LANES) + 2 + len(legend) if lanes else 0
    told = _findings(
        analysis, clock, width, budget - len(top) - len(bottom) - least, whole_texts=whole_texts
    )
    left = budget - len(top) - len(bottom) - len(told)
    states = _states(analysis, lanes, width, left - len(legend)) if lanes else []
    return [*top, *told, *states, *legend, *bottom]


def _top(analysis: Analysis, clock: Clock, width: int) -> Iterator[Line]:
    yield from _wrapped(Line.of(extent(analysis), "dim"), width)
    for line in start_lines(analysis, clock):
        yield from _wrapped(line, width)
    yield from _wrapped(Line.of(verdict(analysis), "bold"), width)


def _wrapped(line: Line, width: int) -> Iterator[Line]:
    """A line of one style broken into as many as it takes."""
    ((text, style),) = line.pieces
    for row in broken(text, width) or [""]:
        yield Line.of(row, style)


def _findings(
    analysis: Analysis, clock: Clock, width: int, room: int, *, whole_texts: bool
) -> list[Line]:
    """The worst findings that there is room for; texts are shortened where that shows more."""
    findings = analysis.findings
    digits = len(str(len(findings)))
    several = len(analysis.capture.buses) > 1
    blocks: list[list[Line]] = []
    for shape in WHOLE if whole_texts else (*WHOLE, *SHORT):
        blocks = [
            _finding(place, each, clock, width, shape, digits=digits, several=several)
            for place, each in enumerate(findings, 1)
        ]
        if sum(map(len, blocks)) <= max(room, 0):
            return [line for block in blocks for line in block]
    lines: list[Line] = []
    shown = 0
    for block in blocks:
        if shown and len(lines) + len(block) > room - len(_left_out(findings[shown:], width)):
            break
        lines += block
        shown += 1
    return [*lines, *_left_out(findings[shown:], width)]


def _left_out(findings: Sequence[Finding], width: int) -> list[Line]:
    if not findings:
        return []
    counts = Counter(SEVERITY_WORDS[each.severity].lower() for each in findings)
    told = ", ".join(counted(count, word) for word, count in counts.items())
    return [*_wrapped(Line.of(f"and {told} more: -v", "dim"), width)]


def _finding(
    place: int,
    finding: Finding,
    clock: Clock,
    width: int,
    shape: Shape,
    *,
    digits: int,
    several: bool,
) -> list[Line]:
    """One finding: its number, how grave, when, where there are several buses on which, what."""
    head = f"{place:>{digits}} {SEVERITY_WORDS[finding.severity]:<8}"
    loud = f"bold {css(SEVERITY_COLOURS[finding.severity])}"
    when = f"{clock.short(finding.start_ns)} " if clock.timed else ""
    bus = f"{printable(finding.bus)}: " if finding.bus and several else ""
    rows = broken(f"{when}{bus}{printable(finding.text)}", width - len(head))
    if shape.lines is not None and len(rows) > shape.lines:
        rows = rows[: shape.lines]
        rows[-1] = _shortened(rows[-1], width - len(head))
    indent = " " * len(head)
    lines = [Line(((head, loud), (rows[0], ""))), *(Line.of(f"{indent}{row}") for row in rows[1:])]
    if shape.check:
        checks = broken(f"check: {printable(finding.check_next)}", width - len(head))
        lines += [Line.of(f"{indent}{row}", "dim") for row in checks]
    return lines


def _shortened(row: str, room: int) -> str:
    while columns(row) > room - len(_ELLIPSIS) and " " in row:
        row = row.rpartition(" ")[0]
    return row + _ELLIPSIS


def _states(analysis: Analysis, lanes: Lanes, width: int, room: int) -> list[Line]:
    """A bar for each node that something is to be seen of; of the others one line tells."""
    capture, labels = analysis.capture, names_of(analysis.nodes)
    several = len(capture.buses) > 1
    ranks = troubled(analysis)
    order = sorted(lanes, key=lambda key: (ranks.get(key, len(ranks) + 9), key))
    not_drawn = [*_wrapped(Line.of(undrawn(capture)), width)] if capture.stretches else []
    most = max(min(room - len(not_drawn) - 2, MOST_LANES), 1)
    chosen = sorted(order if len(order) <= most + 1 else order[:most])
    label_width = min(_LABEL_WIDTH, width // 3)
    heads = {}
    for key in chosen:
        label = labels.get(key, node_label(key[1]))
        label = f"{printable(key[0])} {label}" if several else label
        short = f"{fitted(label, label_width - 2)}.."
        heads[key] = label if columns(label) <= label_width else short
    taken = max(map(columns, heads.values())) + 1
    lines = [Line()] * bool(analysis.findings)
    for key in chosen:
        bar = state_bar(cells(lanes[key], capture.begin_ns, capture.end_ns, width - taken))
        lines.append(Line(((fitted(heads[key], taken), ""), *bar.pieces)))
    lines += not_drawn
    rest = [key for key in lanes if key not in heads]
    if rest:
        ends = Counter(lanes[key][-1].state for key in rest)
        told = ", ".join(f"{count} {state}" for state, count in ends.most_common())
        more = f"{counted(len(rest), 'more node')}, at the end {told}"
        lines += _wrapped(Line.of(more, "dim"), width)
    return lines


def _legend(lanes: Lanes, width: int) -> Iterator[Line]:
    """The letters of the states that there are."""
    seen = {row.state for rows in lanes.values() for row in rows}
    told = [f"{STATE_LETTERS[state]} {str(state).lower()}" for state in NmtState if state in seen]
    yield from _wrapped(Line.of("  ".join(told), "dim"), width)


def _bottom(analysis: Analysis, clock: Clock, width: int) -> Iterator[Line]:
    told: list[str] = []
    syncs: dict[str, list[SyncRow]] = {}
    for row in analysis.sync:
        syncs.setdefault(row.bus, []).append(row)
    for load in analysis.bus_load:
        rate = bit_rate(load)
        parts = [rate if load.bitrate else f"bit rate {rate}"]
        if load.mean_percent is not None:
            peak = number(load.peak_percent, "%", 3)
            parts.append(f"load {number(load.mean_percent, '%', 3)}, at most {peak}")
        parts += [_sync(row) for row in syncs.get(load.bus, ())]
        told.append(f"{printable(load.bus)}: {', '.join(parts)}")
    gaps = analysis.capture.gaps
    if gaps:
        blind = f" for {duration(sum(g.end_ns - g.start_ns for g in gaps))}" if clock.timed else ""
        told.append(f"the recorder was blind {counted(len(gaps), 'time')}{blind}")
    if redaction := Redaction.of_analysis(analysis):
        told.append(f"redacted, nothing is concluded from the payload of {redaction.text}")
    for text in told:
        for line in broken(text, width):
            yield Line.of(line)
    for line in broken("-v: everything   --out DIR: report, plots, tables", width):
        yield Line.of(line, "dim")


def _sync(row: SyncRow) -> str:
    period = ""
    if row.period_us is not None:
        period = f" every {duration(round(1000 * row.period_us.median))}"
    missing = f", {row.missing} missing" if row.missing else ""
    which = "" if row.cob_id == 0x80 else f" {hex_code(row.cob_id, 3)}"
    return f"SYNC{which}{period}{missing}"
