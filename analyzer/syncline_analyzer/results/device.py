"""What was changed in the devices, and how they are."""

from typing import Literal

from syncline_schemas.records import dataclass

ChangeCause = Literal[
    "sdo-write", "side effect", "reset", "factory reset", "seen by a read", "order", "lss"
]
"""How a parameter got its new value."""


@dataclass(frozen=True, slots=True)
class ObjectChangeRow:
    """One change of a parameter, in order of `seq`; the last 2000 of an object, 100,000 in all.

    A value that is written once more makes no row of its own: it is counted in `repeats` of the row
    that brought it. A write of a command (preset, teach, save, load, reset) is a row each time.
    """

    bus: str
    node: int | None
    """None where LSS configured a device whose number is not known."""
    seq: int
    """Frame that confirms the change: the answer to a write, or what tells of the reset."""
    t_ns: int
    index: int | None
    """None for what LSS configured."""
    sub: int | None
    name: str | None
    unit: str | None
    old: int | float | str | None
    """Value before, None where it is not known."""
    new: int | float | str | None
    words: str
    """What the change means: "preset to 1000", "heartbeat every 100 ms"."""
    who: str
    """Who did it: "SDO client on 601h", "the device itself (reset)", "LSS master"."""
    cause: ChangeCause
    client: int | None = None
    """COB-ID of the SDO client's requests; None where no client did it."""
    written: int | None = None
    """`index << 8 | sub` of the object that was written, where it is not the one that changed."""
    old_source: str = "unknown"
    """Where the value before is known from: "sdo-read", "sdo-write", "bus-description",
    "eds-default", "unknown"; "before a reset" where a reset may have changed it unseen."""
    new_source: str = "sdo-write"
    changed: bool | None = True
    """None where the value before was only assumed, so that it may be the same; True for orders."""
    old_words: str = ""
    """The value before in words or with its unit, "" where it is not known."""
    saved: bool | None = None
    """Whether the new value outlives a reset by what the capture shows; None where it says nothing."""
    saved_seq: int | None = None
    """The save (1010h) that keeps it."""
    repeats: int = 0
    """How often the same value was written again before it changed."""


@dataclass(frozen=True, slots=True)
class DeviceHealthRow:
    """What a device told of its own state: one row per node and quantity that was read.

    Figures are in `unit`, None where the value is no number; `text` tells the last value in words.
    """

    bus: str
    node: int
    device: str | None
    what: str
    """"EEPROM writes", "operating time", "temperature", "error list", "error register" ..."""
    index: int
    sub: int
    unit: str
    reads: int
    first_value: float | None
    last_value: float | None
    min: float | None
    max: float | None
    first_ns: int
    last_ns: int
    first_seq: int
    last_seq: int
    text: str = ""
    note: str = ""
    """What a reader must know of it: growth in the capture, a restart, what the counter counts."""
