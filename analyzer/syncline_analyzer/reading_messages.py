"""What the process that reads captures tells the one that analyzes them.

First `Opened`, then a `SentStep` for every step, then `End`; or `Failed` in place of what is left.
"""

from typing import Any

from syncline_analyzer.batch_transfer import PackedBatch
from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.census import Census
from syncline_analyzer.echo import Doubling
from syncline_analyzer.folds.timing.silence import SilenceFold
from syncline_analyzer.preparing import Step
from syncline_analyzer.redaction import Veil
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass


class News(NamedTuple):
    """What is new: all names of buses, and by number of the file its facts that changed."""

    buses: list[str]
    facts: dict[int, dict[str, Any]]


@dataclass(frozen=True, slots=True)
class Opened:
    """The captures could be opened."""

    facts: list[CaptureFacts]
    buses: list[str]
    origin_ns: int | None
    veil: Veil


@dataclass(frozen=True, slots=True)
class SentStep:
    """A step, with its batches beside it."""

    step: Step
    batches: list[PackedBatch]
    news: News


@dataclass(frozen=True, slots=True)
class End:
    """Everything is read."""

    news: News
    census: Census
    doubled: dict[int, Doubling]
    silence: SilenceFold
    veil: Veil


@dataclass(frozen=True, slots=True)
class Failed:
    """What was raised."""

    error: Exception
