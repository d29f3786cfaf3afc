from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class Frame(_message.Message):
    __slots__ = ("can_id", "flags", "dlc", "data")
    CAN_ID_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    DLC_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    can_id: int
    flags: int
    dlc: int
    data: bytes
    def __init__(self, can_id: _Optional[int] = ..., flags: _Optional[int] = ..., dlc: _Optional[int] = ..., data: _Optional[bytes] = ...) -> None: ...

class BusStatus(_message.Message):
    __slots__ = ("state", "tx_errors", "rx_errors", "frames_received", "error_frames", "dropped_kernel", "dropped_controller", "dropped_queue", "adapter_present", "text", "dropped_disk")
    STATE_FIELD_NUMBER: _ClassVar[int]
    TX_ERRORS_FIELD_NUMBER: _ClassVar[int]
    RX_ERRORS_FIELD_NUMBER: _ClassVar[int]
    FRAMES_RECEIVED_FIELD_NUMBER: _ClassVar[int]
    ERROR_FRAMES_FIELD_NUMBER: _ClassVar[int]
    DROPPED_KERNEL_FIELD_NUMBER: _ClassVar[int]
    DROPPED_CONTROLLER_FIELD_NUMBER: _ClassVar[int]
    DROPPED_QUEUE_FIELD_NUMBER: _ClassVar[int]
    ADAPTER_PRESENT_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    DROPPED_DISK_FIELD_NUMBER: _ClassVar[int]
    state: str
    tx_errors: int
    rx_errors: int
    frames_received: int
    error_frames: int
    dropped_kernel: int
    dropped_controller: int
    dropped_queue: int
    adapter_present: bool
    text: str
    dropped_disk: int
    def __init__(self, state: _Optional[str] = ..., tx_errors: _Optional[int] = ..., rx_errors: _Optional[int] = ..., frames_received: _Optional[int] = ..., error_frames: _Optional[int] = ..., dropped_kernel: _Optional[int] = ..., dropped_controller: _Optional[int] = ..., dropped_queue: _Optional[int] = ..., adapter_present: _Optional[bool] = ..., text: _Optional[str] = ..., dropped_disk: _Optional[int] = ...) -> None: ...

class Gap(_message.Message):
    __slots__ = ("start_ns", "end_ns", "reason", "lost_frames", "bus")
    START_NS_FIELD_NUMBER: _ClassVar[int]
    END_NS_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    LOST_FRAMES_FIELD_NUMBER: _ClassVar[int]
    BUS_FIELD_NUMBER: _ClassVar[int]
    start_ns: int
    end_ns: int
    reason: str
    lost_frames: int
    bus: int
    def __init__(self, start_ns: _Optional[int] = ..., end_ns: _Optional[int] = ..., reason: _Optional[str] = ..., lost_frames: _Optional[int] = ..., bus: _Optional[int] = ...) -> None: ...

class ClockSample(_message.Message):
    __slots__ = ("utc_ns", "monotonic_ns", "adapter_ns", "bus", "step_ns", "boot_ns", "slept_ns", "uncertainty_ns", "mapped_ns", "rate_ppb", "residual_ns", "offset_ns")
    UTC_NS_FIELD_NUMBER: _ClassVar[int]
    MONOTONIC_NS_FIELD_NUMBER: _ClassVar[int]
    ADAPTER_NS_FIELD_NUMBER: _ClassVar[int]
    BUS_FIELD_NUMBER: _ClassVar[int]
    STEP_NS_FIELD_NUMBER: _ClassVar[int]
    BOOT_NS_FIELD_NUMBER: _ClassVar[int]
    SLEPT_NS_FIELD_NUMBER: _ClassVar[int]
    UNCERTAINTY_NS_FIELD_NUMBER: _ClassVar[int]
    MAPPED_NS_FIELD_NUMBER: _ClassVar[int]
    RATE_PPB_FIELD_NUMBER: _ClassVar[int]
    RESIDUAL_NS_FIELD_NUMBER: _ClassVar[int]
    OFFSET_NS_FIELD_NUMBER: _ClassVar[int]
    utc_ns: int
    monotonic_ns: int
    adapter_ns: int
    bus: int
    step_ns: int
    boot_ns: int
    slept_ns: int
    uncertainty_ns: int
    mapped_ns: int
    rate_ppb: int
    residual_ns: int
    offset_ns: int
    def __init__(self, utc_ns: _Optional[int] = ..., monotonic_ns: _Optional[int] = ..., adapter_ns: _Optional[int] = ..., bus: _Optional[int] = ..., step_ns: _Optional[int] = ..., boot_ns: _Optional[int] = ..., slept_ns: _Optional[int] = ..., uncertainty_ns: _Optional[int] = ..., mapped_ns: _Optional[int] = ..., rate_ppb: _Optional[int] = ..., residual_ns: _Optional[int] = ..., offset_ns: _Optional[int] = ...) -> None: ...

class Mark(_message.Message):
    __slots__ = ("t_ns", "reason", "bus", "node")
    T_NS_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    BUS_FIELD_NUMBER: _ClassVar[int]
    NODE_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    reason: str
    bus: int
    node: int
    def __init__(self, t_ns: _Optional[int] = ..., reason: _Optional[str] = ..., bus: _Optional[int] = ..., node: _Optional[int] = ...) -> None: ...

class Nmt(_message.Message):
    __slots__ = ("command", "command_name", "node")
    COMMAND_FIELD_NUMBER: _ClassVar[int]
    COMMAND_NAME_FIELD_NUMBER: _ClassVar[int]
    NODE_FIELD_NUMBER: _ClassVar[int]
    command: int
    command_name: str
    node: int
    def __init__(self, command: _Optional[int] = ..., command_name: _Optional[str] = ..., node: _Optional[int] = ...) -> None: ...

class Sync(_message.Message):
    __slots__ = ("counter",)
    COUNTER_FIELD_NUMBER: _ClassVar[int]
    counter: int
    def __init__(self, counter: _Optional[int] = ...) -> None: ...

class Time(_message.Message):
    __slots__ = ("milliseconds", "days_since_1984", "utc_ns")
    MILLISECONDS_FIELD_NUMBER: _ClassVar[int]
    DAYS_SINCE_1984_FIELD_NUMBER: _ClassVar[int]
    UTC_NS_FIELD_NUMBER: _ClassVar[int]
    milliseconds: int
    days_since_1984: int
    utc_ns: int
    def __init__(self, milliseconds: _Optional[int] = ..., days_since_1984: _Optional[int] = ..., utc_ns: _Optional[int] = ...) -> None: ...

class Lss(_message.Message):
    __slots__ = ("from_master", "command", "command_name", "data")
    FROM_MASTER_FIELD_NUMBER: _ClassVar[int]
    COMMAND_FIELD_NUMBER: _ClassVar[int]
    COMMAND_NAME_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    from_master: bool
    command: int
    command_name: str
    data: bytes
    def __init__(self, from_master: _Optional[bool] = ..., command: _Optional[int] = ..., command_name: _Optional[str] = ..., data: _Optional[bytes] = ...) -> None: ...

class Heartbeat(_message.Message):
    __slots__ = ("state", "state_name", "toggle", "boot_up")
    STATE_FIELD_NUMBER: _ClassVar[int]
    STATE_NAME_FIELD_NUMBER: _ClassVar[int]
    TOGGLE_FIELD_NUMBER: _ClassVar[int]
    BOOT_UP_FIELD_NUMBER: _ClassVar[int]
    state: int
    state_name: str
    toggle: int
    boot_up: bool
    def __init__(self, state: _Optional[int] = ..., state_name: _Optional[str] = ..., toggle: _Optional[int] = ..., boot_up: _Optional[bool] = ...) -> None: ...

class Emcy(_message.Message):
    __slots__ = ("code", "meaning", "error_register", "registers", "manufacturer", "text")
    CODE_FIELD_NUMBER: _ClassVar[int]
    MEANING_FIELD_NUMBER: _ClassVar[int]
    ERROR_REGISTER_FIELD_NUMBER: _ClassVar[int]
    REGISTERS_FIELD_NUMBER: _ClassVar[int]
    MANUFACTURER_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    code: int
    meaning: str
    error_register: int
    registers: _containers.RepeatedScalarFieldContainer[str]
    manufacturer: bytes
    text: str
    def __init__(self, code: _Optional[int] = ..., meaning: _Optional[str] = ..., error_register: _Optional[int] = ..., registers: _Optional[_Iterable[str]] = ..., manufacturer: _Optional[bytes] = ..., text: _Optional[str] = ...) -> None: ...

class Sdo(_message.Message):
    __slots__ = ("request", "command", "kind", "index", "sub", "object_name", "data", "abort_code", "abort_text", "text")
    REQUEST_FIELD_NUMBER: _ClassVar[int]
    COMMAND_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    INDEX_FIELD_NUMBER: _ClassVar[int]
    SUB_FIELD_NUMBER: _ClassVar[int]
    OBJECT_NAME_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    ABORT_CODE_FIELD_NUMBER: _ClassVar[int]
    ABORT_TEXT_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    request: bool
    command: int
    kind: str
    index: int
    sub: int
    object_name: str
    data: bytes
    abort_code: int
    abort_text: str
    text: str
    def __init__(self, request: _Optional[bool] = ..., command: _Optional[int] = ..., kind: _Optional[str] = ..., index: _Optional[int] = ..., sub: _Optional[int] = ..., object_name: _Optional[str] = ..., data: _Optional[bytes] = ..., abort_code: _Optional[int] = ..., abort_text: _Optional[str] = ..., text: _Optional[str] = ...) -> None: ...
