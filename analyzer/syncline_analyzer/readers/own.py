"""Syncline's own captures among others."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

from syncline_analyzer.capture import CaptureReader

if TYPE_CHECKING:
    from syncline_analyzer.readers.mcap import McapReader


def own_captures(readers: Iterable[CaptureReader]) -> "list[McapReader]":
    """The readers of those, in order."""
    found = [each for each in readers if each.facts.format == "mcap"]
    if not found:
        return []
    # Logs of other tools need nothing of MCAP, which takes 10 ms to import.
    from syncline_analyzer.readers.mcap import McapReader

    return [each for each in found if isinstance(each, McapReader)]
