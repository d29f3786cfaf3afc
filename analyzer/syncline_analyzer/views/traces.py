"""What the traces tell, in rows for the text and HTML views alike: motion, shafts, tilts, health."""

from collections import Counter
from collections.abc import Iterator, Sequence

from syncline_analyzer.results import (
    Analysis,
    DeviceHealthRow,
    FollowerRow,
    ShaftRow,
    TiltRow,
    TraceEventRow,
    TraceRow,
)
from syncline_analyzer.views.services import Listing
from syncline_analyzer.views.words import (
    Clock,
    names_of,
    node_label,
    number,
    printable,
    trace_object,
)
from syncline_schemas.wording import counted

TURNING_DEG = 60.0
"""With a greater standard deviation the angles lie all round the circle: they have no mean."""
MAX_NOTES = 12
COMPARED = ("Shafts compared", "Encoders that follow one another")
"""Titles of the tables about two nodes each."""
_ERRORS = (0x1001, 0x1003)
_UNTOLD = ("scale_assumed",)
"""Flags that are told in words: which setting was assumed."""
_LOUD = ("jump", "frozen", "out_of_range", "silence", "ambiguous", "wrap")
"""Flags, the worst one first."""
_SETTINGS = {
    "cpr": "counts per turn",
    "range": "measuring range",
    "scaling": "scaling switch",
    "res": "resolution",
    "quad": "quadrants",
    "angle_def": "angle definition",
    "profile": "device profile",
}
"""Names of assumed settings in words."""
_CUTS = {
    "capture gap": "gap",
    "no samples": "silence",
    "node lost": "node lost",
    "another scale": "rescaled",
    "reset command": "reset",
}
"""Reasons for a cut in short, by how the text of the event begins."""

Labels = dict[tuple[str, int], str]
_OfNode = TraceRow | ShaftRow | FollowerRow | TiltRow | DeviceHealthRow


def trace_listings(
    analysis: Analysis, clock: Clock, node: tuple[str, int] | None = None
) -> Iterator[Listing]:
    """Traces, their motion, shafts compared, tilts and health: of all nodes, or of one (bus, node).

    Of one node the columns that name it are left out.
    """
    labels = names_of(analysis.nodes)
    rows = [row for row in analysis.traces if _belongs(node, row)]
    shafts = [r for r in analysis.shafts if _belongs(node, r, (r.other_bus, r.other))]
    followers = [r for r in analysis.followers if _belongs(node, r, (r.bus, r.other))]
    found = [
        _traces(rows, analysis.trace_events, labels),
        _read_as([row for row in rows if row.shows], labels),
        _motion([row for row in rows if _moves(row)], labels),
        _shafts(shafts, labels, clock),
        _followers(followers, labels),
        _tilts([row for row in analysis.tilts if _belongs(node, row)], labels, clock),
        _health([row for row in analysis.device_health if _belongs(node, row)], labels),
    ]
    yield from (_without(each, ("bus", "node")) if node else each for each in found if each.rows)


def trace_notes(rows: Sequence[TraceRow]) -> list[str]:
    """What the figures of the traces rest on: scales that were assumed, samples too far apart."""
    notes: list[str] = []
    for row in rows:
        where = f"node {row.node} {trace_object(row.object)}"
        if row.assumed:
            settings = ", ".join(_SETTINGS.get(name, name) for name in row.assumed)
            notes.append(f"{where}: {settings} only assumed")
        if row.told_below_rpm is not None:
            turned = (
                f"; {counted(row.untold_speeds, 'sample')} may have turned the other way"
                if row.untold_speeds
                else ""
            )
            limit = number(row.told_below_rpm, "rpm", 3)
            notes.append(f"{where}: speed and direction are told only below {limit}{turned}")
    left = len(notes) - MAX_NOTES
    return [*notes[:MAX_NOTES], f"and {left} more notes"] if left > 0 else notes


def _belongs(
    node: tuple[str, int] | None, row: _OfNode, other: tuple[str, int] | None = None
) -> bool:
    """Whether a row is about a node, or about the two of which it is one; None is every node."""
    return node is None or node in ((row.bus, row.node), other)


def _without(listing: Listing, heads: Sequence[str]) -> Listing:
    kept = [i for i, head in enumerate(listing.heads) if head not in heads]
    rows = [[row[i] for i in kept] for row in listing.rows]
    return Listing(listing.title, [listing.heads[i] for i in kept], rows)


def _filled(title: str, heads: Sequence[str], rows: list[list[str]], always: int) -> Listing:
    """The listing without columns in which nothing stands, the first `always` excepted."""
    kept = [i for i in range(len(heads)) if i < always or any(row[i] != "-" for row in rows)]
    return Listing(title, [heads[i] for i in kept], [[row[i] for i in kept] for row in rows])


def _label(labels: Labels, bus: str, node: int) -> str:
    return labels.get((bus, node), node_label(node))


def _read_as(rows: Sequence[TraceRow], labels: Labels) -> Listing:
    """Scale, range and reference (absolute, relative, unknown) by which the values are read."""
    return Listing(
        "Traces read as",
        ["bus", "node", "object", "read as"],
        [
            [
                row.bus,
                _label(labels, row.bus, row.node),
                trace_object(row.object),
                printable(row.shows),
            ]
            for row in rows
        ],
    )


def _traces(rows: Sequence[TraceRow], events: Sequence[TraceEventRow], labels: Labels) -> Listing:
    reasons: dict[tuple[str, int, int], list[str]] = {}
    for event in events:
        if event.kind == "cut":
            key = event.bus, event.node, event.object
            reasons.setdefault(key, []).append(cut_reason(event.text))
    heads = ["bus", "node", "object", "name", ">samples", ">min", ">max", "unit", "cut at", "flags"]
    listed = [
        [
            row.bus,
            _label(labels, row.bus, row.node),
            trace_object(row.object),
            printable(row.name),
            str(row.samples),
            number(row.min),
            number(row.max),
            printable(row.unit),
            _cut_words(row.cuts, reasons.get((row.bus, row.node, row.object), [])),
            _flag_words(row),
        ]
        for row in rows
    ]
    return Listing("Traces", heads, listed)


def cut_reason(text: str) -> str:
    """Why a trace was cut, in one or two words.

    >>> cut_reason("capture gap: adapter lost"), cut_reason("preset (6003h written)")
    ('gap', 'preset')
    """
    short = next((word for start, word in _CUTS.items() if text.startswith(start)), None)
    return short or printable(text).partition(" (")[0]


def _cut_words(cuts: int, reasons: Sequence[str]) -> str:
    if not cuts:
        return "-"
    told = ", ".join(
        reason if count == 1 else f"{count} x {reason}"
        for reason, count in Counter(reasons).items()
    )
    rest = cuts - len(reasons)
    return told if told and rest <= 0 else f"{cuts} in all" + (f": {told} ..." if told else "")


def _flag_words(row: TraceRow) -> str:
    names = [*_LOUD, *(name for name in row.flags if name not in (*_LOUD, *_UNTOLD))]
    told = [f"{row.flags[n]} {n.replace('_', ' ')}" for n in names if row.flags.get(n)]
    return ", ".join(told) or "-"


def _moves(row: TraceRow) -> bool:
    """Whether it is an angle of which anything is known."""
    return row.mean_deg is not None or row.speed_max_rpm is not None


def _motion(rows: Sequence[TraceRow], labels: Labels) -> Listing:
    heads = [
        "bus", "node", "object", ">mean [deg]", ">std [deg]", ">fastest [rpm]", ">turned back",
        ">noise at rest [deg] std/peak", "samples by",
    ]  # fmt: skip
    listed = [
        [
            row.bus,
            _label(labels, row.bus, row.node),
            trace_object(row.object),
            *_mean(row),
            number(row.speed_max_rpm, digits=3),
            "-" if row.direction_changes is None else str(row.direction_changes),
            _noise(row),
            ", ".join(f"{source} {count}" for source, count in row.sources.items()) or "-",
        ]
        for row in rows
    ]
    return _filled("Motion of the traces", heads, listed, 3)


def _mean(row: TraceRow) -> tuple[str, str]:
    if row.mean_deg is None:
        return "-", "-"
    if row.std_deg is None or row.std_deg > TURNING_DEG:
        return "all round", "-"
    return number(row.mean_deg, digits=5), number(row.std_deg, digits=3)


def _noise(row: TraceRow) -> str:
    if row.noise_deg is None:
        return "-"
    return f"{number(row.noise_deg, digits=2)}/{number(row.noise_peak_deg, digits=2)}"


def _shafts(rows: Sequence[ShaftRow], labels: Labels, clock: Clock) -> Listing:
    heads = [
        "encoder", "against", ">ratio", ">compared", ">offset [deg]", ">farthest off [deg]",
        ">allowed [deg]", "parted",
    ]  # fmt: skip
    listed = [
        [
            _label(labels, row.bus, row.node),
            _label(labels, row.other_bus, row.other),
            number(row.ratio),
            f"{row.compared}" + (f" ({row.left_out} left out)" if row.left_out else ""),
            number(row.difference_deg),
            number(row.spread_deg, digits=3),
            number(row.allowed_deg, digits=3),
            _parted(row, clock),
        ]
        for row in rows
    ]
    return Listing(COMPARED[0], heads, listed)


def _followers(rows: Sequence[FollowerRow], labels: Labels) -> Listing:
    heads = ["encoder", "follows", ">ratio", ">compared", ">moved [deg]", ">spread [deg]"]
    listed = [
        [
            _label(labels, row.bus, row.node),
            _label(labels, row.bus, row.other),
            number(row.ratio),
            str(row.compared),
            number(row.moved_deg),
            number(row.spread_deg, digits=3),
        ]
        for row in rows
    ]
    return Listing(COMPARED[1], heads, listed)


def _parted(row: ShaftRow, clock: Clock) -> str:
    if not row.parted:
        return "never" if row.compared else "not known"
    first = "" if row.parted_ns is None else f" at {clock.short(row.parted_ns)}"
    by = "" if row.parted_deg is None else f" by {number(row.parted_deg, 'deg', 3)}"
    return f"{first}{by}".strip() if row.parted == 1 else f"{row.parted} times, first{first}{by}"


def _tilts(rows: Sequence[TiltRow], labels: Labels, clock: Clock) -> Listing:
    heads = ["bus", "node", "object", "angles", ">poses", ">steepest [deg]", "at", "to be known"]
    listed = [
        [
            row.bus,
            _label(labels, row.bus, row.node),
            trace_object(row.object),
            row.definition or "not known",
            f"{row.converted} of {row.samples}",
            number(row.slope_max_deg, digits=3),
            "-" if row.slope_max_ns is None else clock.short(row.slope_max_ns),
            _tilt_words(row),
        ]
        for row in rows
    ]
    return _filled("Tilts in space", heads, listed, 5)


def _tilt_words(row: TiltRow) -> str:
    counts = (
        (row.singular, "at a singular point"),
        (row.impossible, "that no pose has"),
        (row.upright_assumed, "with the z axis taken as up"),
    )
    told = [f"{count} {word}" for count, word in counts if count]
    told += row.reasons
    if row.assumed:
        settings = ", ".join(_SETTINGS.get(name, name) for name in row.assumed)
        told.append(f"{settings} only assumed")
    return "; ".join(told) or "-"


def _health(rows: Sequence[DeviceHealthRow], labels: Labels) -> Listing:
    heads = ["bus", "node", "what", "value", ">lowest", ">highest", ">reads", "to be known"]
    listed = [
        [
            row.bus,
            _label(labels, row.bus, row.node),
            printable(row.what),
            health_value(row),
            number(row.min) if row.min != row.max else "-",
            number(row.max) if row.min != row.max else "-",
            str(row.reads),
            row.note or "-",
        ]
        for row in rows
        if row.index not in _ERRORS
    ]
    return _filled("Health of the devices", heads, listed, 4)


def health_value(row: DeviceHealthRow) -> str:
    """The last value of a quantity with its unit, or in words."""
    if row.text or row.last_value is None:
        return row.text or "not told"
    unit = f" {row.unit}" if row.unit and not row.what.endswith(row.unit) else ""
    return f"{row.last_value:g}{unit}"
