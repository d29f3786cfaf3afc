"""Tables of the report about SYNC, PDOs, error control and the bus; nothing where there are no rows."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from syncline_analyzer.results import (
    Ahead,
    Analysis,
    BusShareRow,
    ErrorControlRow,
    LatenessRow,
    NodeShareRow,
    PdoRow,
    SyncRow,
    WorstRow,
)
from syncline_analyzer.views.basis import (
    deviation,
    jitter_words,
    quartet,
    stepped,
    trio,
    usual_and_most,
)
from syncline_analyzer.views.html import Html, element, table
from syncline_analyzer.views.report_moment import Moments
from syncline_analyzer.views.report_tables import limited
from syncline_analyzer.views.text import pdo_type
from syncline_analyzer.views.waits import late_because, pdo_label
from syncline_analyzer.views.words import (
    duration,
    hex_code,
    names_of,
    node_label,
    number,
)
from syncline_schemas.wording import counted

OPEN_SHARES = 12
"""Identifiers of a bus whose share is shown at once; more open on a click."""
_WORST = 3
"""Longest and shortest of a quantity that are listed; the tables hold ten."""

_STEADY = 0.9
"""Share of the answers from which on their phase is one."""

_US = "min/median/max [us]"
_QUARTET = "min/median/p99/max [us]"
_USUAL = "median/max [us]"
_JITTER = "std/p99-p1 [us]"

OVER_TIME = "Over time"
"""Column of the pictures; a table that has none leaves it out."""

Columns = Sequence[str]
"""Heads of the columns that a table leaves out because they would say the same in every row."""


def _kept(
    caption: str, heads: Sequence[str], rows: Iterable[Sequence[object]], hidden: Columns
) -> Iterator[Html]:
    """The table without the columns that are hidden."""
    kept = [i for i, head in enumerate(heads) if head.removeprefix(">") not in hidden]
    shown = [[row[i] for i in kept] for row in rows]
    yield from limited(caption, [heads[i] for i in kept], shown)


def sync_table(rows: Sequence[SyncRow], hidden: Columns) -> Iterator[Html]:
    """SYNC producers."""
    listed: list[Sequence[object]] = [
        (
            row.bus,
            element("code", hex_code(row.cob_id, 3)),
            row.count,
            quartet(row.period_us, row.resolution_us),
            jitter_words(row.jitter_us, row.resolution_us),
            _expected(row.expected_us, row.expected_source),
            deviation(row.deviation_us, row.expected_us, row.resolution_us),
            _drift(row),
            row.missing,
            row.doubled,
            _producers(row),
            _counter(row),
            row.backlog,
        )
        for row in rows
    ]
    heads = ["Bus", "COB-ID", ">SYNCs", f">Period {_QUARTET}", f">Jitter {_JITTER}", "Expected", ">Median off it [us]", ">Drift [ppm]", ">Missing", ">Doubled", "Producers", "Counter", ">In a backlog (not judged)"]  # fmt: skip
    yield from _kept("SYNC", heads, listed, hidden)


def _expected(us: int | None, source: str | None) -> str:
    return "-" if us is None else f"{us} us ({source})"


def _drift(row: SyncRow) -> str:
    if row.drift_ppm is not None:
        return f"{row.drift_ppm:+.3g}"
    if row.expected_us is None or row.drift_resolution_ppm is None:
        return "-"
    return f"< {row.drift_resolution_ppm:.2g}"


def _producers(row: SyncRow) -> str:
    nodes = ", ".join(map(str, row.producer_nodes))
    return f"{row.producers}" + (f" (told: node {nodes})" if nodes else "")


def _counter(row: SyncRow) -> str:
    if row.counter_max is None:
        return "none"
    told = [f"up to {row.counter_max}"]
    if row.counter_overflow is not None:
        told.append(f"1019h = {row.counter_overflow} ({row.counter_source})")
    if row.counter_jumps:
        told.append(counted(row.counter_jumps, "jump"))
    return ", ".join(told)


def pdo_table(
    caption: str,
    rows: Sequence[PdoRow],
    lateness: Sequence[LatenessRow],
    hidden: Columns,
    picture: Callable[[PdoRow], Html] = lambda row: Html("-"),
) -> Iterator[Html]:
    """PDOs: when each is due, how it came, what did not, and a picture of it over time."""
    why = {(row.bus, row.cob_id): row for row in lateness}
    listed: list[Sequence[object]] = [
        (
            row.bus,
            element("code", hex_code(row.cob_id, 3)),
            "-" if row.node is None else row.node,
            row.pdo or "-",
            row.frames,
            element("div", pdo_type(row), class_="some"),
            element("div", _when(row, why.get((row.bus, row.cob_id))), class_="some"),
            trio(row.period_us, row.resolution_us),
            jitter_words(row.period_jitter_us, row.resolution_us),
            deviation(row.timer_deviation_us, row.event_timer_us, row.resolution_us),
            row.longest_repeat,
            element("div", _faults(row, why.get((row.bus, row.cob_id))), class_="some"),
            picture(row),
        )
        for row in rows
    ]
    heads = ["Bus", "COB-ID", ">Node", "PDO", ">Frames", "Transmission type", "Due", f">Period {_US}", f">Jitter {_JITTER}", ">Median off the timer [us]", ">Same data", "Faults", OVER_TIME]  # fmt: skip
    none = all(row[-1] == "-" for row in listed)
    yield from _kept(caption, heads, listed, (*hidden, OVER_TIME) if none else hidden)


def _when(row: PdoRow, why: LatenessRow | None) -> str:
    """When a PDO is due, in words."""
    told = []
    if row.every is not None:
        told.append("every SYNC" if row.every == 1 else f"every {row.every} SYNCs{_phase(row)}")
    if row.response_us is not None and why is not None and why.window_us:
        told.append(f"within {number(why.window_us / 1000, 'ms')} of it (1007h)")
    if row.event_timer_us is not None:
        told.append(f"timer {number(row.event_timer_us / 1000, 'ms')} ({row.timer_source})")
    if row.inhibit_us:
        source = f" ({row.inhibit_source})" if row.inhibit_source else ""
        told.append(f"inhibit time {number(row.inhibit_us / 1000, 'ms')}{source}")
    if row.deadline_us:
        told.append(f"within {number(row.deadline_us / 1000, 'ms')}")
    if row.repeat_counter:
        told.append(f"{row.repeat_counter} times after a change ({row.repeat_source})")
    if row.asked:
        told.append(f"asked {counted(row.asked, 'time')}")
    return ", ".join(told) or "-"


def _phase(row: PdoRow) -> str:
    if row.phase is None or row.phase_share is None:
        return ""
    moved = f", moved {counted(row.phase_changes, 'time')}" if row.phase_changes else ""
    if row.phase_share < _STEADY:
        return f" (not always the same{moved})"
    share = "" if row.phase_share == 1.0 else f" in {100 * row.phase_share:.4g} %"
    basis = "" if row.phase_basis == "first SYNC" else f" by the {row.phase_basis}"
    return f" (number {row.phase}{basis}{share}{moved})"


def _faults(row: PdoRow, why: LatenessRow | None) -> str:
    counts = {
        "extra": row.extra,
        "too soon": row.too_soon,
        "requests unanswered": row.unanswered,
        "overdue": row.overdue,
    }
    others = (f"{count} {name}" for name, count in counts.items() if count)
    return ", ".join(filter(None, (late_because(row, why), *others))) or "-"


def response_table(caption: str, rows: Sequence[PdoRow], hidden: Columns) -> Iterator[Html]:
    """Synchronous PDOs: response, what of it is the device's, and what the bus made it wait."""
    listed: list[Sequence[object]] = [
        (
            row.bus,
            element("code", hex_code(row.cob_id, 3)),
            "-" if row.node is None else row.node,
            row.pdo or "-",
            row.answered,
            quartet(row.response_us, row.resolution_us),
            jitter_words(row.jitter_us, row.resolution_us),
            _device(row),
            usual_and_most(row.device_us_least, row.resolution_us),
            usual_and_most(row.device_us_free, row.resolution_us),
            usual_and_most(row.waiting_us, row.resolution_us),
        )
        for row in rows
        if row.response_us is not None
    ]
    heads = ["Bus", "COB-ID", ">Node", "PDO", ">Answers", f">Response {_QUARTET}", f">Jitter {_JITTER}", ">Device between (medians) [us]", f">Device at least, by arbitration {_USUAL}", f">Device where the bus was idle {_USUAL}", f">Waited at most {_USUAL}"]  # fmt: skip
    yield from _kept(caption, heads, listed, hidden)


def _device(row: PdoRow) -> str:
    """Bounds by the definition: all frames between SYNC and PDO went ahead of it, or none."""
    if row.device_us_low is None or row.device_us_high is None:
        return "-"
    low = stepped(row.device_us_low.median, row.resolution_us)
    return f"{low} to {stepped(row.device_us_high.median, row.resolution_us)}"


def answer_table(rows: Sequence[PdoRow], hidden: Columns) -> Iterator[Html]:
    """PDOs that were asked for by remote frames."""
    listed: list[Sequence[object]] = [
        (
            row.bus,
            element("code", hex_code(row.cob_id, 3)),
            "-" if row.node is None else row.node,
            row.pdo or "-",
            row.asked,
            row.asked_answered,
            row.unanswered,
            quartet(row.answer_us, row.resolution_us),
        )
        for row in rows
        if row.asked
    ]
    heads = ["Bus", "COB-ID", ">Node", "PDO", ">Requests", ">Answered", ">Not answered while OPERATIONAL", f">Answer {_QUARTET}"]  # fmt: skip
    yield from _kept("PDOs asked for by remote frames", heads, listed, hidden)


def error_control_table(
    caption: str,
    rows: Sequence[ErrorControlRow],
    labels: Mapping[tuple[str, int], str],
    hidden: Columns,
) -> Iterator[Html]:
    """Heartbeats and guard requests."""
    listed: list[Sequence[object]] = [
        (
            row.bus,
            labels.get((row.bus, row.node), row.node),
            row.kind,
            row.count,
            quartet(row.period_us, row.resolution_us),
            jitter_words(row.jitter_us, row.resolution_us),
            _told_time(row),
            deviation(row.deviation_us, row.expected_us, row.resolution_us),
            row.missing,
            "-" if row.worst_us is None else f"frame {row.worst_seq}",
            trio(row.answer_us, row.resolution_us),
        )
        for row in rows
    ]
    heads = ["Bus", "Node", "Kind", ">Count", f">Period {_QUARTET}", f">Jitter {_JITTER}", "Told", ">Median off it [us]", ">Missing", ">Ends the longest", ">Guard answer min/median/max [us]"]  # fmt: skip
    yield from _kept(caption, heads, listed, hidden)


def _told_time(row: ErrorControlRow) -> str:
    if row.expected_us is None:
        return "-"
    return f"{number(row.expected_us / 1000, 'ms')} ({row.expected_source})"


def worst_table(analysis: Analysis, moments: Moments) -> Iterator[Html]:
    """The longest and shortest of each quantity with their frames, to be opened."""
    rows = [*_first(analysis.worst)]
    if not rows:
        return
    listed: list[Sequence[object]] = [
        (
            row.quantity,
            row.bus,
            element("code", hex_code(row.cob_id, 3)),
            "-" if row.node is None else row.node,
            row.extreme,
            number(row.value_us, digits=7),
            moments.when(row.t_ns),
            row.seq,
        )
        for row in rows
    ]
    heads = ["Quantity", "Bus", "COB-ID", ">Node", "Extreme", ">[us]", "At", ">Frame"]
    told = element("summary", "Longest and shortest periods and answers, with their frames")
    yield element("details", told, *limited("Longest and shortest", heads, listed))


def _first(rows: Iterable[WorstRow]) -> Iterator[WorstRow]:
    """The first three of each identifier, quantity and extreme, from the worst on."""
    counts: dict[tuple[str, int, str, str], int] = {}
    for row in rows:
        key = row.bus, row.cob_id, row.quantity, row.extreme
        counts[key] = counts.get(key, 0) + 1
        if counts[key] <= _WORST:
            yield row


def ahead_table(analysis: Analysis, moments: Moments) -> Iterator[Html]:
    """The longest wait of every PDO with all the frames ahead of it, to be opened."""
    labels = pdo_label(analysis)
    longest: dict[tuple[str, int], Sequence[object]] = {}
    for row in sorted(analysis.waits, key=lambda row: -row.waiting_us):
        if row.ahead and (row.bus, row.cob_id) not in longest:
            longest[row.bus, row.cob_id] = (
                moments.when(row.t_ns),
                row.bus,
                labels(row.bus, row.cob_id),
                row.seq,
                number(row.response_us),
                f"{number(row.device_us_least)} to {number(row.device_us_most)}",
                number(row.waiting_us),
                element("div", *_ahead(row.ahead), class_="wrap"),
            )
    if longest:
        heads = ["When", "Bus", "PDO", ">Frame", ">Response [us]", ">Device [us]", ">Waited at most [us]", "Frames ahead of it on the wire"]  # fmt: skip
        told = element("summary", "The longest wait of every PDO, with all the frames ahead of it")
        rows = limited("Longest wait of every PDO", heads, [*longest.values()])
        yield element("details", told, *rows)


def _ahead(rows: Sequence[Ahead]) -> Iterator[Html]:
    for row in rows:
        whose = row.service if row.node is None else f"{row.service} of node {row.node}"
        seqs = ", ".join(map(str, row.seq[:4])) + (", ..." if len(row.seq) > 4 else "")
        frames = "frame" if row.frames == 1 else f"{row.frames} frames"
        told = f" {whose}: {frames} {seqs}, {number(row.us)} us"
        yield element("div", element("code", hex_code(row.cob_id, 3)), told)


def delay_table(analysis: Analysis) -> Iterator[Html]:
    """Whose frames, identifier by identifier, others waited for, to be opened."""
    labels, names = pdo_label(analysis), names_of(analysis.nodes)
    rows = [row for row in analysis.delays if row.cob_id is not None]
    most = max((row.us for row in rows), default=0.0)
    listed: list[Sequence[object]] = [
        (
            row.bus,
            element("code", hex_code(row.cob_id, 3)),
            names.get((row.bus, row.node or 0), node_label(row.node)),
            row.service,
            f"{row.frames:,}",
            f"{row.delayed:,}",
            duration(round(1000 * row.us)),
            _bar(row.us / most if most else 0.0),
            number(row.worst_us),
            labels(row.bus, row.worst_cob_id),
            row.worst_seq,
        )
        for row in sorted(rows, key=lambda row: -row.us)
    ]
    if listed:
        heads = ["Bus", "COB-ID", "Of node", "Service", ">Frames", ">Answers that waited", ">In all", "", ">Worst [us]", "Worst of", ">Frame"]  # fmt: skip
        told = element("summary", "Who delays whom, by identifier")
        caption = "Frames that answers waited for (at most)"
        yield element("details", told, *limited(caption, heads, listed))


def share_tables(analysis: Analysis) -> Iterator[Html]:
    """What each node and each identifier takes of a bus."""
    names = names_of(analysis.nodes)
    for bus in analysis.capture.buses:
        nodes = [row for row in analysis.node_shares if row.bus == bus]
        ids = [row for row in analysis.bus_shares if row.bus == bus]
        if nodes:
            heads = ["Node", ">Frames", ">Share of the traffic", "", ">Load"]
            rows = [_share(_sender(row, names), row) for row in nodes]
            yield from limited(f"Traffic of {bus} by node", heads, rows)
        if ids:
            heads = ["COB-ID", "Service", "Node", ">Frames", ">Share of the traffic", "", ">Load"]
            listed = [_share(_identifier(row, names), row) for row in ids]
            part = table(f"Traffic of {bus} by identifier", heads, listed[:OPEN_SHARES])
            yield part
            if rest := listed[OPEN_SHARES:]:
                told = element("summary", f"{len(rest)} more identifiers of {bus}")
                yield element(
                    "details", told, *limited(f"More identifiers of {bus}", heads, [*rest])
                )


def _sender(row: NodeShareRow, names: Mapping[tuple[str, int], str]) -> list[object]:
    if row.node is None:
        return ["master and others"]
    return [names.get((row.bus, row.node), node_label(row.node))]


def _identifier(row: BusShareRow, names: Mapping[tuple[str, int], str]) -> list[object]:
    digits = 8 if row.extended else 3
    code = "other 29-bit" if row.cob_id is None else hex_code(row.cob_id, digits)
    remote = " (remote)" if row.remote else ""
    sender = "-" if row.node is None else names.get((row.bus, row.node), node_label(row.node))
    return [element("code", f"{code}{remote}"), row.service, sender]


def _share(whose: list[object], row: BusShareRow | NodeShareRow) -> Sequence[object]:
    return [
        *whose,
        f"{row.frames:,}",
        f"{row.share_percent:.2f} %",
        _bar(row.share_percent / 100),
        "-" if row.load_percent is None else f"{row.load_percent:.2f} %",
    ]


def _bar(share: float) -> Html:
    width = f"width:{min(max(share, 0.0), 1.0) * 100:.4g}%"
    return element("div", element("i", style=width), class_="bar", aria_hidden="true")
