"""python-can's messages as the columns of a frame batch, and back."""

from collections.abc import Iterator, Sequence

from syncline_logger.lean_can import can
from syncline_schemas.batch import FrameBatch, FrameFlag

_EXTENDED = int(FrameFlag.EXTENDED)
_REMOTE = int(FrameFlag.REMOTE)
_ERROR = int(FrameFlag.ERROR)
_FD = int(FrameFlag.FD)
_BRS = int(FrameFlag.BRS)
_ESI = int(FrameFlag.ESI)
_TX = int(FrameFlag.TX)
_DLC_INVALID = int(FrameFlag.DLC_INVALID)
_NO_DATA = bytearray()
_SECOND_NS = 1_000_000_000

Channel = str | int | None
"""What python-can calls the bus that a message came from."""


def ns_of(timestamp: float) -> int:
    """Seconds as nanoseconds, to the nearest: a product of floats would be off by 128 ns today."""
    whole = int(timestamp)
    return whole * _SECOND_NS + round((timestamp - whole) * 1e9)


def fields_of(message: can.Message) -> tuple[int, int, int, bytearray]:
    """Identifier, `FrameFlag` bits, length in bytes and data of a message."""
    flags = _flags(message)
    data, length = message.data, message.dlc
    if flags & _REMOTE:
        data = _NO_DATA
    elif length != len(data):
        # A classic frame's DLC of 9 to 15 means eight bytes (ISO 11898-1).
        if flags & _FD or length <= 8 or len(data) != 8:
            flags |= _DLC_INVALID
        length = len(data)
    return message.arbitration_id & 0x1FFF_FFFF, flags, length & 0xFF, data


def _flags(message: can.Message) -> int:
    flags = _EXTENDED if message.is_extended_id else 0
    if message.is_remote_frame:
        flags |= _REMOTE
    if message.is_fd:
        flags |= _FD | (_BRS if message.bitrate_switch else 0)
        flags |= _ESI if message.error_state_indicator else 0
    if message.is_error_frame:
        flags |= _ERROR
    return flags if message.is_rx else flags | _TX


def messages_of(batch: FrameBatch, channels: Sequence[Channel]) -> Iterator[can.Message]:
    """The rows of a batch as messages; `channels` holds python-can's name of each bus number."""
    columns = (batch.t_ns, batch.bus, batch.can_id, batch.flags, batch.dlc)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    for row, (t_ns, bus, can_id, flags, dlc) in enumerate(rows):
        yield can.Message(
            timestamp=t_ns / _SECOND_NS,
            arbitration_id=can_id,
            is_extended_id=bool(flags & _EXTENDED),
            is_remote_frame=bool(flags & _REMOTE),
            is_error_frame=bool(flags & _ERROR),
            channel=channels[bus] if bus < len(channels) else bus,
            dlc=dlc,
            data=batch.payload(row),
            is_fd=bool(flags & _FD),
            is_rx=not flags & _TX,
            bitrate_switch=bool(flags & _BRS),
            error_state_indicator=bool(flags & _ESI),
        )
