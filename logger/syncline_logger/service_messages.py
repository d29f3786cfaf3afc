"""CANopen services as protobuf messages: NMT, SYNC, TIME, LSS, heartbeat, EMCY, SDO."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from google.protobuf.message import Message
from numpy.typing import NDArray

from syncline_logger.sdo_listener import SdoFrame, SdoPass
from syncline_schemas.batch import FrameBatch
from syncline_schemas.canopen.lss import COMMANDS
from syncline_schemas.canopen.nmt import STATE_OF_BYTE, command_name
from syncline_schemas.canopen.sdo import abort_meaning
from syncline_schemas.canopen.services import Service
from syncline_schemas.capture.message import MessageBlock, MessageSchema, schema_of
from syncline_schemas.decoder import (
    SdoKind,
    decode_emcy,
    decode_lss,
    decode_nmt,
    decode_time,
)
from syncline_schemas.devices import Device, quirks
from syncline_schemas.devices.model import emcy_meaning, register_bits
from syncline_schemas.proto import syncline_pb2

_UNREGISTERED = -1
_FIRST_REQUEST = 0x600

Messages = Sequence[Message | None]
"""One per frame; None where the frame is no well-formed message of the service."""

Encode = Callable[[FrameBatch, NDArray[np.int64], Device | None], MessageBlock]
"""Makes the messages of frames of one identifier, taken at these log times."""

_NO_MESSAGE = -1


@dataclass(frozen=True)
class ServiceEncoder:
    """How frames of a service become messages.

    Attributes:
        name: last part of the topic.
        of_node: whether the topic is a node's or the bus's.
        message_type: the protobuf class.
        encode: makes the messages.
    """

    name: Any
    of_node: bool
    message_type: type[Message]
    encode: Encode

    @cached_property
    def schema(self) -> MessageSchema:
        """The channel's schema."""
        return schema_of(self.message_type.DESCRIPTOR)


def _one_by_one(messages_of: Callable[[FrameBatch, Device | None], Messages]) -> Encode:
    """For services that are rare on a bus."""

    def encode(
        frames: FrameBatch, log_ns: NDArray[np.int64], device: Device | None
    ) -> MessageBlock:
        messages = messages_of(frames, device)
        rows = [row for row, message in enumerate(messages) if message is not None]
        return MessageBlock.of_messages(
            _UNREGISTERED,
            log_ns[rows],
            frames.t_ns[rows],
            [message for message in messages if message is not None],
        )

    return encode


def _looked_up(
    messages: Sequence[Message],
    numbers_of: Callable[[FrameBatch, Device | None], NDArray[np.intp]],
) -> Encode:
    """For services with few different messages and many frames: each frame's number in a table."""
    payloads = [message.SerializeToString() for message in messages]
    lengths = np.array([len(payload) for payload in payloads], np.int64)
    width = int(lengths.max())
    table = np.frombuffer(b"".join(each.ljust(width, b"\0") for each in payloads), np.uint8)
    table = table.reshape(len(payloads), width)
    used = np.arange(width) < lengths[:, np.newaxis]

    def encode(
        frames: FrameBatch, log_ns: NDArray[np.int64], device: Device | None
    ) -> MessageBlock:
        numbers = numbers_of(frames, device)
        rows = np.flatnonzero(numbers != _NO_MESSAGE)
        numbers = numbers[rows]
        return MessageBlock(
            _UNREGISTERED,
            log_ns[rows],
            frames.t_ns[rows],
            lengths[numbers],
            table[numbers][used[numbers]],
        )

    return encode


def _nmt(frames: FrameBatch, device: Device | None) -> Messages:
    columns = decode_nmt(frames.data, frames.dlc)
    return [
        syncline_pb2.Nmt(command=int(c), command_name=command_name(int(c)), node=int(n))
        if valid
        else None
        for c, n, valid in zip(columns.command, columns.node, columns.valid, strict=True)
    ]


_SYNCS = [*(syncline_pb2.Sync(counter=n) for n in range(256)), syncline_pb2.Sync()]
_SYNC_WITHOUT_COUNTER = 256


def _sync_number(frames: FrameBatch, device: Device | None) -> NDArray[np.intp]:
    without = np.where(frames.dlc == 0, _SYNC_WITHOUT_COUNTER, _NO_MESSAGE)
    return np.where(frames.dlc == 1, frames.data[:, 0], without)


def _time(frames: FrameBatch, device: Device | None) -> Messages:
    columns = decode_time(frames.data, frames.dlc)
    return [
        syncline_pb2.Time(milliseconds=int(ms), days_since_1984=int(days), utc_ns=int(t_ns))
        if valid
        else None
        for ms, days, t_ns, valid in zip(
            columns.ms, columns.days, columns.t_ns, columns.valid, strict=True
        )
    ]


def _lss(frames: FrameBatch, device: Device | None) -> Messages:
    columns = decode_lss(frames.can_id, frames.data, frames.dlc)
    return [
        syncline_pb2.Lss(
            from_master=bool(request),
            command=int(command),
            command_name=COMMANDS.get(int(command), f"unknown {int(command):02X}h"),
            data=argument.tobytes(),
        )
        if valid
        else None
        for command, request, argument, valid in zip(
            columns.command, columns.request, columns.argument, columns.valid, strict=True
        )
    ]


def _heartbeat(byte: int) -> syncline_pb2.Heartbeat:
    state = byte & 0x7F
    known = STATE_OF_BYTE.get(state)
    return syncline_pb2.Heartbeat(
        state=state,
        state_name="boot-up" if byte == 0 else known.value if known else f"unknown {state:02X}h",
        toggle=byte >> 7,
        boot_up=byte == 0,
    )


_HEARTBEATS = [
    *(_heartbeat(byte) for byte in range(256)),
    syncline_pb2.Heartbeat(state_name="boot-up or no state", boot_up=True),
]
_BOOT_UP_OR_NO_STATE = 256
"""The byte 00h of a device that also sends it once it was asked by a remote frame."""


def _heartbeat_number(frames: FrameBatch, device: Device | None) -> NDArray[np.intp]:
    first = frames.data[:, 0].astype(np.intp)
    if quirks(device).empty_heartbeat_after_rtr:
        first[first == 0] = _BOOT_UP_OR_NO_STATE
    return np.where(frames.dlc == 1, first, _NO_MESSAGE)


def _emcy(frames: FrameBatch, device: Device | None) -> Messages:
    columns = decode_emcy(frames.data, frames.dlc)
    return [
        _emcy_message(int(code), int(register), manufacturer.tobytes(), device) if valid else None
        for code, register, manufacturer, valid in zip(
            columns.code, columns.register, columns.manufacturer, columns.valid, strict=True
        )
    ]


def _emcy_message(
    code: int, register: int, manufacturer: bytes, device: Device | None
) -> syncline_pb2.Emcy:
    meaning, names = emcy_meaning(device, code), register_bits(device, register)
    return syncline_pb2.Emcy(
        code=code,
        meaning=meaning,
        error_register=register,
        registers=names,
        manufacturer=manufacturer,
        text=f"{code:04X}h {meaning}; error register {register:02X}h"
        + (f" ({', '.join(names)})" if names else ""),
    )


SDO_KINDS: dict[SdoKind, str] = {
    SdoKind.UNKNOWN: "unknown",
    SdoKind.DOWNLOAD_REQUEST: "download",
    SdoKind.DOWNLOAD_ANSWER: "download",
    SdoKind.UPLOAD_REQUEST: "upload",
    SdoKind.UPLOAD_ANSWER: "upload",
    SdoKind.DOWNLOAD_SEGMENT: "segment",
    SdoKind.DOWNLOAD_SEGMENT_ANSWER: "segment",
    SdoKind.UPLOAD_SEGMENT_REQUEST: "segment",
    SdoKind.UPLOAD_SEGMENT: "segment",
    SdoKind.ABORT: "abort",
    SdoKind.BLOCK_DOWNLOAD: "block",
    SdoKind.BLOCK_UPLOAD: "block",
}


def encode_sdo(
    done: SdoPass,
    chosen: NDArray[np.intp],
    frames: FrameBatch,
    log_ns: NDArray[np.int64],
    device: Device | None,
) -> MessageBlock:
    """Messages of the chosen SDO frames of a pass; `frames` and `log_ns` are of the whole batch."""
    rows = done.rows[chosen]
    messages = [
        _block_segment(frames.data[row], bool(frames.can_id[row] >= _FIRST_REQUEST))
        if done.segment[i]
        else _sdo_message(done.frames[i], device)
        for i, row in zip(chosen.tolist(), rows.tolist(), strict=True)
    ]
    return MessageBlock.of_messages(_UNREGISTERED, log_ns[rows], frames.t_ns[rows], messages)


def _block_segment(data: NDArray[np.uint8], request: bool) -> syncline_pb2.Sdo:
    command = int(data[0])
    last = ", the last" if command & 0x80 else ""
    return syncline_pb2.Sdo(
        request=request,
        command=command,
        kind="block segment",
        data=data[1:8].tobytes(),
        text=f"block segment {command & 0x7F}{last}",
    )


def _sdo_message(sdo: SdoFrame, device: Device | None) -> syncline_pb2.Sdo:
    message = syncline_pb2.Sdo(
        request=sdo.request, command=sdo.command, kind=SDO_KINDS[sdo.kind], data=sdo.payload
    )
    place, abort_text = "", ""
    if sdo.addressed:
        name = (device and device.object_name(sdo.index, sdo.sub)) or ""
        message.index, message.sub, message.object_name = sdo.index, sdo.sub, name
        place = f" {sdo.index:04X}h:{sdo.sub:02X} {name}".rstrip()
    if sdo.kind == SdoKind.ABORT:
        message.abort_code = sdo.abort_code
        message.abort_text = abort_text = abort_meaning(sdo.abort_code)
    value = f" = {sdo.payload.hex(' ').upper()}" if sdo.payload else ""
    direction = "request" if sdo.request else "answer"
    message.text = f"{SDO_KINDS[sdo.kind]} {direction}{place}{value}" + (
        f": {abort_text} ({sdo.abort_code:08X}h)" if abort_text else ""
    )
    return message


SDO_SCHEMA = schema_of(syncline_pb2.Sdo.DESCRIPTOR)

ENCODERS: dict[Service, ServiceEncoder] = {
    Service.NMT: ServiceEncoder("nmt", False, syncline_pb2.Nmt, _one_by_one(_nmt)),
    Service.SYNC: ServiceEncoder(
        "sync", False, syncline_pb2.Sync, _looked_up(_SYNCS, _sync_number)
    ),
    Service.TIME: ServiceEncoder("time", False, syncline_pb2.Time, _one_by_one(_time)),
    Service.LSS: ServiceEncoder("lss", False, syncline_pb2.Lss, _one_by_one(_lss)),
    Service.ERROR_CONTROL: ServiceEncoder(
        "heartbeat", True, syncline_pb2.Heartbeat, _looked_up(_HEARTBEATS, _heartbeat_number)
    ),
    Service.EMCY: ServiceEncoder("emcy", True, syncline_pb2.Emcy, _one_by_one(_emcy)),
}
