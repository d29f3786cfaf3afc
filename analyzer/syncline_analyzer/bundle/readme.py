"""README.txt of a bundle: what is in it, for somebody who has never heard of Syncline."""

from collections.abc import Mapping, Sequence
from typing import Any

from syncline_analyzer.results import Analysis
from syncline_analyzer.views.markdown import extent, verdict
from syncline_analyzer.views.words import printable

FIRST_FINDINGS = 5


def readme(
    analysis: Analysis, facts: Mapping[str, Any], members: Sequence[tuple[str, str]]
) -> bytes:
    """The text; members are names with what each is."""
    width = max(len(name) for name, _ in members)
    lines = [
        "Evidence from a CANopen bus, made by Syncline",
        "=============================================",
        "",
        "Open report.html in any browser. It needs no network and no other program.",
        "",
        extent(analysis),
        f"Result: {verdict(analysis)}.",
        *(f"  {row.severity}: {printable(row.text)}" for row in analysis.findings[:FIRST_FINDINGS]),
        "",
        "In this file:",
        *(f"  {name:<{width}}  {what}" for name, what in members),
        "",
        *_cut(facts),
        *_redacted(facts),
        *(f"Note: {note}." for note in facts["notes"]),
        *([""] if facts["notes"] else []),
        "The numbers of frames in the report count the frames of capture.mcap, from 0.",
        "",
        "Whether all of it is as it was put in:  syncline bundle --check FILE.zip",
        "To analyze it again, as it is:          syncline analyze FILE.zip",
        "capture.mcap is an MCAP file (mcap.dev): Foxglove, Rerun and the mcap tools open it too.",
        "",
    ]
    return "\n".join(lines).encode()


def _cut(facts: Mapping[str, Any]) -> list[str]:
    cut = facts["cut"]
    if cut is None:
        return ["The capture is complete: nothing was cut.", ""]
    around = f" around {cut['around']}" if cut["around"] else ""
    return [
        f"The capture is a part{around}: {cut['frames']:,} frames. Left out are",
        f"{cut['frames_before']:,} frames before it and {cut['frames_after']:,} after it.",
        "What the nodes told of their settings before that part was kept.",
        "",
    ]


def _redacted(facts: Mapping[str, Any]) -> list[str]:
    redacted = facts["redacted"]
    if redacted is None:
        return ["No payload was removed.", ""]
    return [
        f"The sender removed the data bytes of {redacted['frames']:,} frames. Identifiers (hexadecimal):",
        f"{redacted['identifiers']}.",
        "These frames keep their time, identifier and length; their bytes are zero and mean nothing.",
        "Report and analysis were made afterwards, from the frames as they are in here.",
        "",
    ]
