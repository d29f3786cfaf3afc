"""The frames of the device sheets, decoded: every key that a vector expects is compared.

The vectors were made from the manuals and checked against the canopen library by other people's
programs (see the sheets); what they say that no single frame or pair of frames tells is listed in
`NEEDS_HISTORY` and tested with the analyses.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.canopen.nmt import COMMANDS, STATE_OF_BYTE
from syncline_schemas.canopen.sdo import LOAD_SIGNATURE, SAVE_SIGNATURE, abort_meaning
from syncline_schemas.canopen.services import Service, predefined_pdo, service_of
from syncline_schemas.decoder import (
    PdoColumn,
    PdoMapping,
    SdoColumns,
    SdoKind,
    decode_emcy,
    decode_error_control,
    decode_nmt,
    decode_pdo,
    decode_sdo,
)
from syncline_schemas.devices import Device, load_device
from syncline_schemas.measurement import (
    EncoderAngles,
    count_steps,
    encoder_angles,
    encoder_scale,
    tilt_axis,
    tilt_deg,
    tilt_scale,
)

VECTORS = Path(__file__).parent.parent / "data" / "vectors"
NEEDS_HISTORY = {
    ("LB01", 1, "bootup"): "a 7Fh is a boot-up only after the reset",
    ("LB03", 2, "state"): "a byte 00h is empty only after the remote frame, with heartbeat on",
    ("LB03", 2, "empty"): "a byte 00h is empty only after the remote frame, with heartbeat on",
}
_COMMAND_NAMES = {
    "start": "start",
    "stop": "stop",
    "enter pre-operational": "preop",
    "reset node": "reset_node",
    "reset communication": "reset_comm",
}
_OPERATIONS = {
    SdoKind.DOWNLOAD_REQUEST: "write",
    SdoKind.DOWNLOAD_ANSWER: "write-ack",
    SdoKind.UPLOAD_REQUEST: "read",
    SdoKind.UPLOAD_ANSWER: "read-rsp",
    SdoKind.UPLOAD_SEGMENT_REQUEST: "segment",
    SdoKind.UPLOAD_SEGMENT: "segment",
    SdoKind.ABORT: "abort",
}
_KINDS = {
    Service.NMT: "nmt",
    Service.SYNC: "sync",
    Service.EMCY: "emcy",
    Service.ERROR_CONTROL: "error-control",
}


@dataclass
class Seen:
    """What our decoders say of one frame."""

    frame: FrameBatch
    device: Device
    context: dict[str, Any]
    before: "Seen | None"

    @property
    def can_id(self) -> int:
        return int(self.frame.can_id[0])

    @property
    def service(self) -> Service:
        return Service(int(service_of(self.frame)[0]))

    @cached_property
    def sdo(self) -> SdoColumns:
        request = np.array([self.service == Service.SDO_REQUEST])
        return decode_sdo(request, self.frame.data, self.frame.dlc)

    @cached_property
    def key(self) -> tuple[int, int]:
        return int(self.sdo.index[0]), int(self.sdo.sub[0])

    def payload(self) -> bytes:
        return self.sdo.payload[0, : self.sdo.length[0]].tobytes()

    def value(self) -> Any:
        """Value in the object's type; of an object that is in no dictionary as a plain number."""
        value = self.device.value(*self.key, self.payload())
        unknown = self.device.object(*self.key) is None
        return int.from_bytes(self.payload(), "little") if unknown else value

    @cached_property
    def pdo(self) -> list[PdoColumn]:
        number = self.pdo_number()
        values = [
            value
            for sub in (1, 2, 3)
            if isinstance(value := self.device.default(0x1A00 + number - 1, sub, 1), int)
        ]
        mapping = PdoMapping.from_objects(values, self.device)
        assert mapping.length == int(self.frame.dlc[0])
        return decode_pdo(mapping, self.frame.data, self.frame.dlc)

    def pdo_number(self) -> int:
        found = predefined_pdo(self.can_id)
        assert found is not None
        assert found[0] == "tpdo"
        return found[1]

    def angles(self) -> EncoderAngles:
        lookup = {(0x6000, 0): 4 if self.device.name == "haomiao-38" else 0}
        lookup[0x6001, 0] = self.context["cpr"]
        lookup[0x6002, 0] = self.context["range"]
        lookup[0x6502, 0] = self.context["range"] // self.context["cpr"]
        scale = encoder_scale(
            self.device, lambda i, s: (lookup[i, s], False) if (i, s) in lookup else None
        )
        assert scale.assumed == ()
        return encoder_angles(np.asarray(self.pdo[0].raw, np.int64), scale)

    def delta(self) -> int:
        assert self.before is not None
        pair = [int(seen.angles().position[0]) for seen in (self.before, self)]
        return int(count_steps(np.array(pair), self.context["range"])[0])

    def tilt(self, index: int, raw: int, bits: int) -> float:
        lookup = {(0x6000, 0): self.context["res"], (0x2040, 0): self.context.get("quad", 2)}
        scale = tilt_scale(
            self.device, lambda i, s: (lookup[i, s], False) if (i, s) in lookup else None
        )
        axis = tilt_axis(self.device, index)
        assert axis is not None
        degrees = tilt_deg(np.array([raw]), bits, scale.deg_per_count, scale.axes[axis])
        return float(degrees[0])

    def tilt_of_pdo(self, column: int) -> float:
        entry = self.pdo[column].entry
        return self.tilt(entry.index, int(self.pdo[column].raw[0]), entry.bits)

    def emcy(self) -> tuple[int, int, bytes]:
        columns = decode_emcy(self.frame.data, self.frame.dlc)
        assert columns.valid[0]
        return int(columns.code[0]), int(columns.register[0]), columns.manufacturer[0].tobytes()

    def state(self) -> str | None:
        columns = decode_error_control(self.frame.data, self.frame.dlc, np.array([False]))
        if columns.empty[0]:
            return None
        return "boot-up" if columns.boot_up[0] else STATE_OF_BYTE[int(columns.state[0])].lower()

    def kind(self) -> str:
        if self.frame.is_remote(0):
            return "rtr-tpdo" if self.service == Service.PDO else "guard-request"
        return "tpdo" if self.service == Service.PDO else _KINDS[self.service]


def _cmd(seen: Seen) -> str:
    columns = decode_nmt(seen.frame.data, seen.frame.dlc)
    assert columns.valid[0]
    return _COMMAND_NAMES[COMMANDS[int(columns.command[0])]]


def _node(seen: Seen) -> int:
    if seen.service == Service.NMT:
        return int(decode_nmt(seen.frame.data, seen.frame.dlc).node[0])
    return seen.can_id & 0x7F


def _size(seen: Seen) -> int | None:
    size = int(seen.sdo.size[0])
    return None if size < 0 else size


def _toggle(seen: Seen) -> int:
    if seen.service == Service.ERROR_CONTROL:
        columns = decode_error_control(seen.frame.data, seen.frame.dlc, np.array([False]))
        return int(columns.toggle[0])
    return int(seen.sdo.toggle[0])


def _kbit(seen: Seen) -> int:
    assert seen.key == seen.device.quirks.bitrate_object
    return seen.device.quirks.bitrates[seen.value()] // 1000


def _serial(seen: Seen) -> str:
    facts = seen.device.object(*seen.key)
    assert facts is not None
    return facts.describe(seen.value())


def _engineering(seen: Seen) -> float:
    facts = seen.device.object(*seen.key)
    assert facts is not None
    assert facts.unit == "degC"
    return float(seen.value() * facts.scale)


def _named_value(seen: Seen, name: str, unit: str) -> float:
    column = next(c for c in seen.pdo if c.entry.name == name)
    assert column.entry.unit == unit
    return float(column.value[0])


READ: dict[str, Callable[[Seen], Any]] = {
    "cmd": _cmd,
    "node": _node,
    "kind": Seen.kind,
    "state": Seen.state,
    "empty": lambda s: s.state() is None,
    "toggle": _toggle,
    "dlc": lambda s: int(s.frame.dlc[0]),
    "op": lambda s: _OPERATIONS[SdoKind(int(s.sdo.kind[0]))],
    "index": lambda s: s.key[0],
    "sub": lambda s: s.key[1],
    "value": Seen.value,
    "size": _size,
    "segmented_size": lambda s: _size(s) if not s.sdo.expedited[0] else None,
    "data": lambda s: s.payload().decode(),
    "last": lambda s: bool(s.sdo.last[0]),
    "nonstandard": lambda s: int(s.sdo.command[0]) != 0x40,
    "sig": lambda s: {SAVE_SIGNATURE: "save", LOAD_SIGNATURE: "load"}[s.value()],
    "name": lambda s: s.device.object_name(*s.key),
    "kbit": _kbit,
    "serial": _serial,
    "abort": lambda s: int(s.sdo.abort_code[0]),
    "text": lambda s: abort_meaning(int(s.sdo.abort_code[0])),
    "pdo_off": lambda s: bool(s.value() >> 31),
    "canid": lambda s: s.value() & 0x7FF,
    "code": lambda s: s.emcy()[0],
    "group": lambda s: s.emcy()[0] >> 8,
    "reg": lambda s: s.emcy()[1],
    "bits": lambda s: s.device.register_bits(s.emcy()[1]),
    "mfr": lambda s: s.emcy()[2].hex(),
    "alarms": lambda s: s.device.emcy_details(s.emcy()[2])["alarms"],
    "warnings": lambda s: s.device.emcy_details(s.emcy()[2])["warnings"],
    "clear": lambda s: s.emcy()[0] >> 8 == 0 and s.emcy()[1] == 0 and not any(s.emcy()[2]),
    "n": Seen.pdo_number,
    "pos": lambda s: int(s.angles().position[0]),
    "turn": lambda s: int(s.angles().turn[0]),
    "in_range": lambda s: bool(s.angles().in_range[0]),
    "delta": Seen.delta,
    "raw": lambda s: [int(column.raw[0]) for column in s.pdo],
    "long": lambda s: s.tilt_of_pdo(0),
    "lat": lambda s: s.tilt_of_pdo(1),
    "veff": lambda s: _named_value(s, "Veff", "mm/s"),
    "apeak": lambda s: _named_value(s, "aPeak", "g"),
    "degC": _engineering,
}


def _deg(seen: Seen) -> float:
    if seen.service == Service.PDO:
        return float(seen.angles().angle_deg[0])
    return seen.tilt(seen.key[0], seen.value(), 16)


READ["deg"] = _deg


def frame_of(text: str) -> FrameBatch:
    can_id, _, data = text.partition("#")
    remote = data == "R"
    payload = b"" if remote else bytes.fromhex(data)
    flags = int(FrameFlag.REMOTE) if remote else 0
    return FrameBatch.from_rows([(0, 0, int(can_id, 16), flags, len(payload), payload)])


def all_vectors() -> Iterator[Any]:
    for path in sorted(VECTORS.glob("*.json")):
        for vector in json.loads(path.read_text(encoding="utf-8")):
            yield pytest.param(vector, id=vector["id"])


@pytest.mark.parametrize("vector", list(all_vectors()))
def test_a_vector_is_decoded_as_its_sheet_says(vector: dict[str, Any]) -> None:
    device = load_device(vector["device"])
    before: Seen | None = None
    for number, step in enumerate(vector["frames"]):
        seen = Seen(frame_of(step["frame"]), device, vector["context"], before)
        for key, expected in step["expect"].items():
            if (vector["id"], number, key) in NEEDS_HISTORY:
                continue
            found = READ[key](seen)
            if isinstance(expected, float):
                assert found == pytest.approx(expected, abs=1e-5), (number, key)
            else:
                assert found == expected, (number, key)
        before = seen


def test_all_vectors_of_the_sheets_are_here() -> None:
    assert len(list(all_vectors())) == 22 + 33 + 29 + 32


def test_what_needs_history_is_still_asked_for() -> None:
    asked = {
        (vector["id"], number, key)
        for param in all_vectors()
        for vector in param.values
        for number, step in enumerate(vector["frames"])
        for key in step["expect"]
    }
    assert asked >= NEEDS_HISTORY.keys()
