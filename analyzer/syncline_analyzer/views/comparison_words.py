"""A comparison in words: what the text and the page say alike."""

from pathlib import Path

from syncline_analyzer.comparison.rows import Comparison, ComparisonRow, UnseenRow
from syncline_analyzer.results import CaptureRow
from syncline_analyzer.views.words import Clock, duration, printable

EVIDENCE = 5
"""Frames that are named; tables and JSON hold the others."""
_WORDS = (("error", "error"), ("warning", "warning"), ("info", "note"))


def comparison_verdict(comparison: Comparison) -> str:
    """One sentence: how much differs, or why that cannot be said."""
    if empty := empty_sides(comparison):
        sides = " and the ".join(empty)
        verb = "holds" if len(empty) == 1 else "hold"
        return f"The {sides} {verb} no frames: nothing can be compared"
    told = []
    for severity, word in _WORDS:
        count = sum(row.severity == severity for row in comparison.rows)
        told += [f"{count} {word}{'s'[: count != 1]}"] if count else []
    if not told:
        return "Nothing differs from the golden capture"
    return f"Different from the golden capture: {', '.join(told)}"


def empty_sides(comparison: Comparison) -> list[str]:
    """Which of both hold no frame."""
    sides = (("golden capture", comparison.golden), ("capture", comparison.capture))
    return [name for name, capture in sides if not capture.frames]


def side_words(capture: CaptureRow, heard_s: float | None) -> str:
    """A capture by its files, frames and how long it listened."""
    files = ", ".join(printable(Path(file).name) for file in capture.files)
    time = " without times" if heard_s is None else f" in {duration(round(heard_s * 1e9))}"
    time = time if capture.frames else ""
    damage = "; damaged, read in part" if capture.damage else ""
    frames = f"{capture.frames:,} frame{'' if capture.frames == 1 else 's'}"
    return f"{files}: {frames}{time}{damage}"


def place(row: ComparisonRow | UnseenRow) -> str:
    """Node and bus that a row is about."""
    bus = row.bus or "all buses"
    return f"node {row.node} on {bus}" if row.node else bus


def evidence(row: ComparisonRow, comparison: Comparison) -> list[str]:
    """Frames of each side that prove a difference, with the time of the first."""
    sides = (
        ("golden", comparison.golden, row.golden_seq, row.golden_ns),
        ("capture", comparison.capture, row.capture_seq, row.capture_ns),
    )
    told = []
    for name, capture, seqs, t_ns in sides:
        clock = Clock.of(capture)
        parts = [f"at {clock.short(t_ns)}"] if t_ns is not None and clock.timed else []
        if seqs:
            frames = ", ".join(map(str, seqs[:EVIDENCE]))
            more = f" and {len(seqs) - EVIDENCE} more" if len(seqs) > EVIDENCE else ""
            parts.append(f"frame{'s'[: len(seqs) != 1]} {frames}{more}")
        if parts:
            told.append(f"{name} {' '.join(parts)}")
    return told


def unseen_line(row: UnseenRow) -> str:
    """Something that one of both could not have shown."""
    side = "the golden capture" if row.not_seen_in == "golden" else "the capture"
    return printable(f"{row.subject}: not seen in {side}; {row.reason}")
