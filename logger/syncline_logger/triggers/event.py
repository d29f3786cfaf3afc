"""What a trigger may stand for: one thing that happened, as the analyzer would tell it."""

from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "emcy", "node-lost", "boot-up", "nmt", "bus-off", "sdo-abort", "value", "gap", "asked"
]


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened.

    `t_ns` is when it happened, `log_ns` the log time at which it was known [ns]. `detail` is the
    code of an EMCY or abort, the NMT state, or the word of the condition on a value.
    """

    kind: Kind
    t_ns: int
    log_ns: int
    text: str
    bus: int | None = None
    node: int | None = None
    detail: int | str | None = None


@dataclass(frozen=True, slots=True)
class Trigger:
    """An event that somebody waits for; `text` counts those that it stands for besides."""

    t_ns: int
    log_ns: int
    bus: int | None
    node: int | None
    text: str
