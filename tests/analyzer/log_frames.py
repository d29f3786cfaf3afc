"""Frames of every kind, and what of them a format keeps."""

from collections.abc import Callable, Sequence

from syncline_schemas.batch import FrameFlag
from tests.analyzer.log_builder import Row, row

EXTENDED, REMOTE, ERROR, FD = (
    FrameFlag.EXTENDED,
    FrameFlag.REMOTE,
    FrameFlag.ERROR,
    FrameFlag.FD,
)
BRS, ESI, TX = FrameFlag.BRS, FrameFlag.ESI, FrameFlag.TX

FRAMES: tuple[Row, ...] = (
    row(0, 0x080),
    row(150, 0x181, bytes(range(8))),
    row(300, 0x701, b"\x05", flags=TX),
    row(450, 0x18FEF100, bytes.fromhex("FF00A5"), flags=EXTENDED),
    row(600, 0x123, bytes.fromhex("0DF00D"), flags=EXTENDED, bus=1),
    row(750, 0x70A, flags=REMOTE, dlc=1),
    row(900, 0x1ABCDE01, flags=REMOTE | EXTENDED, dlc=8),
    row(1_050, 0x40, bytes(range(0x10, 0x18)), flags=ERROR),
    row(1_200, 0x88, bytes.fromhex("0004190000001122"), flags=ERROR, bus=1),
    row(1_350, 0x7FF, bytes(range(0x40, 0x4C)), flags=FD),
    row(1_500, 0x18DAF110, bytes(range(64)), flags=FD | BRS | EXTENDED),
    row(1_650, 0x111, b"\x01\x02", flags=FD | BRS | ESI, bus=1),
    row(3_601_000_000, 0x000, bytes.fromhex("0100"), flags=TX),
    row(30_000_000_000, 0x085, bytes.fromhex("3081110000000000")),
)
"""Every kind of frame, on two buses, past midnight."""

Encoder = Callable[[Sequence[Row]], bytes]
Keeper = Callable[[Row], Row | None]


def everything(frame: Row) -> Row | None:
    """Nothing is lost."""
    return frame


def plain_errors(frame: Row) -> Row | None:
    """Nothing but the contents of error frames is lost."""
    if frame[3] & ERROR:
        return (frame[0], frame[1], 0, int(ERROR), 8, bytes(8))
    return frame


def classic(frame: Row) -> Row | None:
    """CAN FD cannot be told."""
    return None if frame[3] & FD else frame


def data_frames(frame: Row) -> Row | None:
    """Nothing but classic data frames."""
    return None if frame[3] & (FD | ERROR | REMOTE) else frame


def data_and_remote(frame: Row) -> Row | None:
    """Classic data and remote frames."""
    return None if frame[3] & (FD | ERROR) else frame


def without_direction(frame: Row) -> Row | None:
    """Everything but who sent it."""
    return (*frame[:3], frame[3] & ~TX, *frame[4:])


def flags_of(frame: Row) -> FrameFlag:
    return FrameFlag(frame[3])
