"""What is to be read of which captures."""

from collections.abc import Mapping, Sequence
from dataclasses import field
from pathlib import Path

from syncline_analyzer.moments import Moment
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class Request:
    """What is to be read: captures, and the half-open stretch [start, end) of them.

    offsets: as `parse_offset` takes them, by path or name of a capture.
    """

    paths: Sequence[Path]
    start: Moment | None = None
    end: Moment | None = None
    offsets: Mapping[str, str] = field(default_factory=dict)
