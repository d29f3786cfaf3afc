"""Captures opened for a pass over their frames."""

from collections.abc import Iterator, Mapping

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.deafness import Numbered
from syncline_analyzer.redaction import Redaction
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import Device
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class Opened:
    """Frames of a session from the first one on, and what is known of them beforehand.

    Attributes:
        facts: of every file; complete once the stream is read.
        buses: names by bus number; may grow while the stream is read.
        description, devices: what the user or the capture says of buses and nodes.
        redaction: what the captures say of dropped payloads.
        first_ns: first stamp of all, None when there are no frames.
        low_ns, high_ns: half-open range of time that the session is about.
        stream: (`seq`, batch or gap).
        live: whether frames come while they happen, so that none may wait for the next.
    """

    facts: list[CaptureFacts]
    buses: list[str]
    description: BusDescription
    devices: Mapping[int, Device]
    redaction: Redaction
    first_ns: int | None
    low_ns: int
    high_ns: int
    stream: Iterator[Numbered]
    live: bool = False
