"""Findings as Markdown, for the text panel of the Rerun viewer."""

from pathlib import Path

from syncline_analyzer.results import Analysis, Finding
from syncline_analyzer.views.basis import basis_lines
from syncline_analyzer.views.words import Clock, duration, names_of, node_label, printable
from syncline_schemas.named_tuples import NamedTuple

_MARKS = {"error": "ERROR", "warning": "WARNING", "info": "NOTE"}
HEADLINES = 30
"""Findings that are listed in a line each before the stories."""
CHAIN_LINES = 12
"""Links of a story that are shown; the tables hold them all."""


def findings_markdown(analysis: Analysis) -> str:
    """The verdict, every finding in a line, then each as a story."""
    capture, clock = analysis.capture, Clock.of(analysis.capture)
    starts = f" Starts {clock.full(capture.start_utc_ns)}." if capture.start_utc_ns else ""
    lines = [f"### {verdict(analysis)}", ""]
    several = len(capture.buses) > 1
    numbered = [*enumerate(analysis.findings, 1)]
    lines += [_headline(place, each, clock, several) for place, each in numbered[:HEADLINES]]
    if (left := len(analysis.findings) - HEADLINES) > 0:
        lines.append(f"- and {left} more, told below")
    lines += ["", _escaped(extent(analysis)) + starts]
    for damage in capture.damage:
        lines += ["", f"**Damaged, read in part:** {_escaped(damage)}"]
    for place, finding in numbered:
        lines += _story(place, finding, clock, names_of(analysis.nodes))
    if basis := list(basis_lines(analysis)):
        lines += [
            "",
            "### What the timing rests on",
            "",
            *(f"- {_escaped(line)}" for line in basis),
        ]
    return "\n".join(lines) + "\n"


def _headline(place: int, finding: Finding, clock: Clock, several: bool) -> str:
    when = f"{clock.short(finding.start_ns)} " if clock.timed else ""
    bus = f"{_escaped(finding.bus)}: " if several and finding.bus else ""
    return f"- **{place} {_MARKS[finding.severity]}** {when}{bus}{_escaped(finding.text)}"


def verdict(analysis: Analysis) -> str:
    """One sentence: what the findings add up to, or that there are none."""
    counts = {
        name: sum(f.severity == severity for f in analysis.findings)
        for severity, name in (("error", "error"), ("warning", "warning"), ("info", "note"))
    }
    told = [f"{n} {name}{'s' if n > 1 else ''}" for name, n in counts.items() if n]
    if not analysis.capture.frames:
        return ", ".join(["No frames in this capture", *told])
    if told:
        return ", ".join(told)
    if not analysis.nodes:
        return "No CANopen node in this capture"
    return "Nothing found"


def extent(analysis: Analysis) -> str:
    """What the capture holds, in one sentence."""
    capture = analysis.capture
    files = ", ".join(Path(file).name for file in capture.files)
    if not capture.frames:
        return printable(f"{files}: no frames.")
    time = " without times"
    if capture.time_base != "none":
        time = f" in {duration(capture.duration_ns)}" if capture.duration_ns else " at one moment"
    buses = f" on {', '.join(capture.buses)}" if capture.buses else ""
    nodes = len(analysis.nodes)
    return printable(
        f"{files}: {capture.frames:,} frame{'s'[: capture.frames != 1]}{time}{buses},"
        f" {nodes} node{'s'[: nodes != 1]}."
    )


def where(finding: Finding, labels: dict[tuple[str, int], str]) -> str:
    """Node and bus that a finding is about."""
    if finding.node is None:
        return finding.bus or "all buses"
    label = labels.get((finding.bus or "", finding.node), node_label(finding.node))
    return f"node {label}" + (f" on {finding.bus}" if finding.bus else "")


class ChainLine(NamedTuple):
    """One piece of a story: "before it" where it began before the finding, else "followed by"."""

    label: str
    text: str


def chain_lines(finding: Finding, clock: Clock) -> list[ChainLine]:
    """The other pieces of a story, a line each with its time; the longest chains are cut."""
    lines = [
        ChainLine(
            "before it" if clock.timed and link.start_ns < finding.start_ns else "followed by",
            f"{clock.short(link.start_ns)}: {link.text}" if clock.timed else link.text,
        )
        for link in finding.chain[:CHAIN_LINES]
    ]
    rest = len(finding.chain) - CHAIN_LINES
    return [*lines, ChainLine("followed by", f"and {rest} more")] if rest > 0 else lines


def _story(
    place: int, finding: Finding, clock: Clock, labels: dict[tuple[str, int], str]
) -> list[str]:
    when = f"**When** {clock.stretch(finding.start_ns, finding.end_ns)}, " if clock.timed else ""
    return [
        "",
        "---",
        "",
        f"**{place} {_MARKS[finding.severity]}: {_escaped(finding.text)}**",
        "",
        f"{when}{_escaped(where(finding, labels))}",
        "",
        *(f"- {line.label} {_escaped(line.text)}" for line in chain_lines(finding, clock)),
        *([""] if finding.chain else []),
        f"**Likely cause** {_escaped(finding.cause)}",
        "",
        f"**Check next** {_escaped(finding.check_next)}",
        "",
        *([f"**Assumed** {_escaped('; '.join(finding.assumed))}", ""] if finding.assumed else []),
        f"`{finding.id}`, evidence: frames {', '.join(map(str, finding.evidence[:10])) or '-'}",
    ]


def _escaped(text: str) -> str:
    return "".join(f"\\{c}" if c in "\\`*_{}[]<>#|" else c for c in printable(text))
