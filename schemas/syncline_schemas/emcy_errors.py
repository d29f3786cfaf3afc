"""The errors that are active on a node by its EMCYs (CiA 301 7.2.7.2), and which of them a "no error" message ends."""

from collections.abc import Iterator, Sequence
from dataclasses import field
from typing import Literal

from syncline_schemas.canopen.emcy import group_bit
from syncline_schemas.devices import Device
from syncline_schemas.records import dataclass

GENERIC_BIT = 0x01
"""Bit 0 of 1001h goes with any error, so it tells of none in particular."""
SHARED_BITS = 0x11
"""Bits that a device may set with an error of another kind: generic and communication."""

MAX_ACTIVE = 254
"""Errors of a node at one time: 1003h holds no more (CiA 301 7.5.2.3)."""
MAX_ALIKE = 8
"""Errors of one code told apart by the maker's bytes; more of them are no fault numbers."""

Verdict = Literal["gone", "stays", "maybe"]


@dataclass(slots=True)
class ActiveError:
    """An error that is there.

    `register` holds the bits set with it; `fresh` and `fresh_words` those of the register and of
    the device's alarm words that were new with it. `certain` turns False with a clear that may
    have ended it, and True again with its next message. `doubted` is (seq, t_ns) of a clear that
    ended it, unless that was only the clear before once more.
    """

    code: int
    manufacturer: bytes
    raised_ns: int
    register: int
    fresh: int
    fresh_words: int = 0
    count: int = 1
    certain: bool = True
    doubted: tuple[int, int] | None = None
    evidence: list[int] = field(default_factory=list)


class ErrorList:
    """The errors of one node that its EMCYs tell; fed with whole messages (eight bytes) in order.

    Attributes:
        active: errors that are there, in order of their raise; who ends one takes it out.
        device: whose tables say what bits stand for; it may become known later.
    """

    def __init__(self, device: Device | None) -> None:
        self.device = device
        self.active: list[ActiveError] = []
        self._register = self._words = 0
        self._last = b""

    def raised(self, code: int, data: bytes, t_ns: int) -> tuple[ActiveError | None, bool]:
        """The error that a message of a code other than 00xxh tells, and whether it is a new one.

        None where there are too many already.
        """
        register, manufacturer = data[2], data[3:8]
        alike = [error for error in self.active if error.code == code]
        known = self._known(code, manufacturer)
        if known is None and len(alike) >= MAX_ALIKE:
            known = alike[-1]
        if known is not None:
            known.count += 1
            known.certain, known.doubted = True, None
            return known, False
        if len(self.active) >= MAX_ACTIVE:
            return None, False
        words = words_of(self.device, manufacturer)
        fresh, fresh_words = register & ~self._register, words & ~self._words
        error = ActiveError(code, manufacturer, t_ns, register, fresh, fresh_words)
        self.active.append(error)
        return error, True

    def ended_unseen(self, code: int, data: bytes) -> ActiveError | None:
        """The error that a message tells again, and that the clear in doubt has ended therefore.

        A device tells an error once (CiA 301 7.2.7.2), unless it was seen to repeat it.
        """
        known = self._known(code, data[3:8])
        return known if known is not None and known.doubted and known.count == 1 else None

    def _known(self, code: int, manufacturer: bytes) -> ActiveError | None:
        """The active error that a message repeats."""
        return next((e for e in self.active if self._same(e, code, manufacturer)), None)

    def remember(self, data: bytes) -> None:
        """Keep the bits of a message: what is new in the next one is that one's."""
        self._register, self._words = data[2], words_of(self.device, data[3:8])
        self._last = data[:8]

    def forget(self) -> None:
        """The node has started anew: the bits of its next message are all new."""
        self._register = self._words = 0

    def ended_by(self, data: bytes, at: tuple[int, int] = (0, 0)) -> list[ActiveError] | None:
        """Errors that a message 00xxh ends while others are left; None when nothing is left.

        `at` is its (seq, t_ns).
        """
        register, manufacturer = data[2], data[3:8]
        named = self._named(register, manufacturer)
        if named and (register or len(named) < len(self.active)):
            return named
        if not register and not words_of(self.device, manufacturer):
            return None
        repeated = data[:8] == self._last
        gone = gone_errors(self.device, self.active, register, manufacturer, repeated=repeated)
        if repeated and len(gone) == 1 and not gone[0].certain:
            gone[0].doubted = gone[0].doubted or at
            return []
        return gone

    def _same(self, error: ActiveError, code: int, manufacturer: bytes) -> bool:
        """Whether a message repeats an error.

        Where the low byte of the code tells nothing, the maker's bytes tell errors apart, unless
        the device's table says that they hold its alarm words.
        """
        fields = self.device is not None and bool(self.device.emcy_fields)
        return error.code == code and (
            bool(code & 0xFF) or fields or error.manufacturer == manufacturer
        )

    def _named(self, register: int, manufacturer: bytes) -> list[ActiveError]:
        """Errors that a clear names by the bytes with which they were raised.

        A register of 0 outweighs them where the device's table says what its bits stand for. Where
        it is not 0, the first byte alone may name the error, as CANopenNode does.
        """
        device = self.device
        if not any(manufacturer) or (
            device and (device.emcy_fields or (device.emcy_registers and not register))
        ):
            return []
        named = [error for error in self.active if error.manufacturer == manufacturer]
        first = [error.manufacturer[0] for error in self.active]
        distinct = len(first) > 1 and len(set(first)) == len(first)
        if named or not register or not manufacturer[0] or not distinct:
            return named
        return [error for error in self.active if error.manufacturer[0] == manufacturer[0]]


def gone_errors(
    device: Device | None,
    active: Sequence[ActiveError],
    register: int,
    manufacturer: bytes,
    *,
    repeated: bool,
) -> list[ActiveError]:
    """Errors that a clear with bits left ends.

    A clear tells that at least one error is gone (CiA 301 7.2.7.2): where the bits prove none and
    leave it open of one of several only, it is that one, but not `certain` where the message is
    `repeated`. Else none ends, and none that may be meant is `certain` any more.
    """
    verdicts = [_verdict(device, error, active, register, manufacturer) for error in active]
    gone = [error for error, told in zip(active, verdicts, strict=True) if told == "gone"]
    open_ = [error for error, told in zip(active, verdicts, strict=True) if told == "maybe"]
    if gone:
        return gone
    single = len(open_) == 1 and len(active) > 1
    for error in open_:
        error.certain = single and not repeated
    return open_ if single else []


def _verdict(
    device: Device | None,
    error: ActiveError,
    active: Sequence[ActiveError],
    register: int,
    manufacturer: bytes,
) -> Verdict:
    """The most telling bits decide: alarm words that stand for it, its own ones of the register."""
    words = mapped_words(device, error.code, error.manufacturer)
    if not words and not _mask_of(device, error.code) & error.register & ~GENERIC_BIT:
        words = error.fresh_words & ~_all_mapped(device)
    if words:
        return "stays" if words & words_of(device, manufacturer) else "gone"
    own = _own_bits(device, error)
    if own:
        if not own & register:
            return "gone"
        others = (_own_bits(device, other) for other in active if other is not error)
        return "maybe" if any(own & bits for bits in others) else "stays"
    return "maybe" if register & GENERIC_BIT or not error.register else "gone"


def _own_bits(device: Device | None, error: ActiveError) -> int:
    """Register bits that came with an error: by the device's table, by CiA 301, else the new ones.

    Not the generic bit, which says nothing where it is still set.
    """
    standard = group_bit(error.code)
    told = (_mask_of(device, error.code), 0 if standard is None else 1 << standard, error.fresh)
    for mask in told:
        if own := mask & error.register & ~GENERIC_BIT:
            return own
    return 0


def codes_told(device: Device | None, register: int, manufacturer: bytes) -> tuple[int, ...]:
    """Codes that the device's table gives for the bits set, the more telling ones first."""
    if device is None:
        return ()
    masks = device.emcy_registers.items()
    codes = [code for bit, codes in masks if register >> bit & 1 for code in codes]
    words = [code for code, _ in _set_words(device, manufacturer)]
    return tuple(dict.fromkeys([*words, *codes]))


def codes_unexplained(
    device: Device | None, active: Sequence[ActiveError], register: int, manufacturer: bytes
) -> tuple[int, ...]:
    """Codes that the device's table gives for bits that none of the active errors explains."""
    if device is None:
        return ()
    own = {error.code for error in active}
    groups = {code >> 8 for code in own}
    found = [code for code, _ in _set_words(device, manufacturer) if code not in own]
    for bit, codes in device.emcy_registers.items():
        explained = groups & {code >> 8 for code in codes} or bit in map(group_bit, own)
        if register & ~SHARED_BITS & 1 << bit and not explained:
            found.extend(codes)
    return tuple(dict.fromkeys(found))


def words_of(device: Device | None, manufacturer: bytes) -> int:
    """The maker's bytes as one number, as far as the device's table has them as words of bits."""
    mask = 0
    for part in device.emcy_fields if device else ():
        mask |= ((1 << 8 * part.length) - 1) << 8 * part.start
    return int.from_bytes(manufacturer, "little") & mask


def mapped_words(device: Device | None, code: int, manufacturer: bytes) -> int:
    """Bits within the maker's bytes that stand for a code and are set."""
    return sum(1 << bit for told, bit in _set_words(device, manufacturer) if told == code)


def _all_mapped(device: Device | None) -> int:
    """Bits within the maker's bytes that the device's table gives to codes."""
    parts = device.emcy_fields if device else ()
    return sum(1 << bit + 8 * part.start for part in parts for bit in part.codes)


def _set_words(device: Device | None, manufacturer: bytes) -> Iterator[tuple[int, int]]:
    """(code, bit within the maker's bytes) of every bit set that stands for a code."""
    words = words_of(device, manufacturer)
    for part in device.emcy_fields if device else ():
        for bit, code in part.codes.items():
            if words >> 8 * part.start + bit & 1:
                yield code, 8 * part.start + bit


def _mask_of(device: Device | None, code: int) -> int:
    """Register bits that stand for a code by the device's table."""
    masks = device.emcy_registers.items() if device else ()
    return sum(1 << bit for bit, codes in masks if code in codes)
