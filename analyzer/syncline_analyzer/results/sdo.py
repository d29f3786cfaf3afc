"""SDO transfers and what they tell of the objects."""

from typing import Literal

from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class SdoRow:
    """One SDO transfer."""

    bus: str
    node: int
    seq: int
    start_ns: int
    end_ns: int
    index: int | None
    """None when the capture starts in the middle of a transfer."""
    sub: int | None
    direction: Literal["upload", "download"]
    kind: Literal["expedited", "segmented", "block"]
    size: int | None
    value: int | float | str | None
    """Decoded by the object's type where it is known; else the hexadecimal bytes as sent."""
    result: Literal["ok", "abort", "no answer", "interrupted"]
    abort_code: int | None
    answer_us: float | None
    name: str | None = None
    data: bytes = b""
    end_seq: int | None = None
    announced: int | None = None
    """Bytes that the protocol states; None where it does not (22h, 42h, size not indicated)."""
    crc_ok: bool | None = None
    """Whether the CRC of a block transfer fits its data; None where there is none to check."""
    abort_by: Literal["client", "server"] | None = None
    abort_text: str | None = None
    """The abort code in words."""
    client_cob_id: int | None = None
    """COB-ID of the client's requests: which SDO channel it used."""


@dataclass(frozen=True, slots=True)
class ObjectRow:
    """Last known value of an object: seen on the bus, or an assumed parameter of an analysis.

    `seq` and `t_ns` are those of the transfer that told the value, None where it is assumed. It
    holds since `since_seq`, by `cause`: "sdo-read", "sdo-write", "side effect", "reset" (the saved
    value came back) or "factory reset"; "" where it always held.
    """

    bus: str
    node: int
    index: int
    sub: int
    name: str | None
    unit: str | None
    value: int | float | str
    source: str
    seq: int | None
    t_ns: int | None
    meaning: str = ""
    """The value in words, "" where the number says it all."""
    since_seq: int | None = None
    since_ns: int | None = None
    cause: str = ""
    saved: bool | None = None
    """Whether a written value outlives a reset, None where it was not written in the capture."""


@dataclass(frozen=True, slots=True)
class ObjectHistoryRow:
    """One value of an object and the stretch in which it held; at most 2000 per object.

    It holds from `start_seq` on and before `until_seq` (None: to the end). `source` is where the
    value comes from, "unknown" where a reset left nothing that is known; `seq` is the transfer that
    told it; `cause` is as in `ObjectRow`.
    """

    bus: str
    node: int
    index: int
    sub: int
    name: str | None
    unit: str | None
    value: int | float | str | None
    meaning: str
    source: str
    cause: str
    seq: int | None
    start_seq: int
    start_ns: int
    until_seq: int | None
    until_ns: int | None
