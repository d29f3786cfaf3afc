"""Words for NMT, error control, SYNC, TIME, EMCY, LSS and error frames."""

import numpy as np

from syncline_analyzer.decode.part import Tone, Words
from syncline_analyzer.views.words import hex_code, printable
from syncline_schemas.can_errors import can_error
from syncline_schemas.canopen import emcy, lss, nmt
from syncline_schemas.decoder import decode_time
from syncline_schemas.devices import Device
from syncline_schemas.devices.model import emcy_details, emcy_meaning, register_bits

GUARD_REQUEST = Words("guard request", Tone.QUIET)
NO_STATE = Words("no state byte", Tone.ORDER)
_STATE_TONES: dict[str, Tone] = {
    nmt.NmtState.OPERATIONAL: Tone.QUIET,
    nmt.NmtState.STOPPED: Tone.BAD,
    nmt.NmtState.PRE_OPERATIONAL: Tone.PLAIN,
}


def nmt_words(data: bytes, names: dict[int, str]) -> Words:
    """An NMT command and whom it is for.

    >>> nmt_words(bytes([0x81, 0]), {}).text, nmt_words(bytes([1, 5]), {5: "5 boom"}).text
    ('reset node: all nodes', 'start: node 5 boom')
    """
    if len(data) != 2:
        return Words(f"NMT command with {len(data)} instead of 2 bytes", Tone.BAD)
    whom = f"node {names.get(data[1], data[1])}" if data[1] else "all nodes"
    return Words(f"{nmt.command_name(data[0])}: {whom}", Tone.ORDER)


def error_control_words(data: bytes, *, guarded: bool, boots: bool, empty: bool = False) -> Words:
    r"""A boot-up, heartbeat or guard answer.

    guarded: somebody asks this node with remote frames. boots: the analyses take it for a boot-up.
    empty: a device whose heartbeats have the byte 00h once it was asked with a remote frame.

    >>> error_control_words(b"\x05", guarded=False, boots=False).text
    'OPERATIONAL'
    >>> error_control_words(b"\x85", guarded=True, boots=False).text
    'OPERATIONAL, toggle 1'
    """
    if not data:
        return NO_STATE
    number = data[0] & 0x7F
    if not data[0] and empty and not boots:
        return Words("no state (00h after a remote frame)", Tone.QUIET)
    if not data[0]:
        return Words("boot-up" + _surplus(data, 1), Tone.ORDER)
    state = nmt.STATE_OF_BYTE.get(number)
    text = str(state) if state is not None else f"unknown state {hex_code(number, 2)}"
    if boots:
        text = f"boot-up, {text}"
    if guarded or data[0] & 0x80:
        text += f", toggle {data[0] >> 7}"
    tone = Tone.ORDER if boots or not number else _STATE_TONES.get(state or "", Tone.BAD)
    return Words(text + _surplus(data, 1), tone)


def sync_words(data: bytes) -> Words:
    r"""A SYNC and its counter.

    >>> sync_words(b"").text, sync_words(b"\x07").text
    ('SYNC', 'SYNC 7')
    """
    return Words(f"SYNC {data[0]}" if data else "SYNC", Tone.QUIET)


def time_words(data: bytes) -> Words:
    """The time that a TIME message tells."""
    if len(data) < 6:
        return Words(f"TIME with {len(data)} instead of 6 bytes", Tone.BAD)
    row = np.frombuffer(data[:8].ljust(8, b"\0"), np.uint8)[np.newaxis]
    told = decode_time(row, np.array([len(data)], np.uint8))
    moment = np.datetime64(int(told.t_ns[0]), "ns").astype("datetime64[ms]")
    return Words(str(moment).replace("T", " "), Tone.QUIET)


def emcy_words(device: Device | None, data: bytes) -> Words:
    """Code, meaning, error register and the maker's bytes of an EMCY.

    >>> emcy_words(None, bytes.fromhex("3081110000000000")).text
    '8130h life guard or heartbeat error, register 11h generic, communication'
    """
    code = int.from_bytes(data[:2], "little")
    said = printable(emcy_meaning(device, code))
    if len(data) < emcy.EMCY_BYTES:
        return Words(emcy.short_message(data, said if len(data) > 1 else ""), Tone.BAD)
    parts = [f"{hex_code(code)} {said}"]
    names = ", ".join(register_bits(device, data[2]))
    parts.append(f"register {hex_code(data[2], 2)}{' ' + printable(names) if names else ''}")
    parts += _details(device, data[3:8])
    clear = code >> 8 == 0
    return Words(", ".join(parts), Tone.BAD if not clear or data[2] else Tone.GOOD)


def _details(device: Device | None, manufacturer: bytes) -> list[str]:
    details = emcy_details(device, manufacturer)
    told = []
    for name, value in details.items():
        if isinstance(value, list) or not value:
            continue
        bits = details.get(f"{name}_bits")
        told.append(f"{name} {', '.join(bits) if bits else hex_code(value, 2)}")
    if not told and any(manufacturer):
        told = [manufacturer.hex(" ")]
    return [printable(text) for text in told]


def lss_words(data: bytes, *, request: bool) -> Words:
    """An LSS frame."""
    said = lss.decode_frame(data, request=request)
    return Words(said.text, Tone.BAD if said.refused else Tone.ORDER)


def error_words(can_id: int, data: bytes) -> Words:
    """An error frame, with the controller's counters where it tells them."""
    said = can_error(can_id, data)
    text = said.words
    if said.tx_errors is not None:
        text += f" (errors: {said.tx_errors} sending, {said.rx_errors} receiving)"
    return Words(text, Tone.BAD)


def _surplus(data: bytes, wanted: int) -> str:
    return f" ({len(data)} bytes)" if len(data) != wanted else ""
