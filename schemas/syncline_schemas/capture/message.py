"""Messages of one channel on their way into a chunk, and the schemas that describe them."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Self, Union

import numpy as np
from google.protobuf.descriptor import Descriptor, FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message
from numpy.typing import NDArray

from syncline_schemas.capture.layout import PROTOBUF
from syncline_schemas.records import dataclass

if TYPE_CHECKING:  # the type stubs know two classes of descriptors, of which one runs
    from google._upb import _message

AnyDescriptor = Union[Descriptor, "_message.Descriptor"]
AnyFileDescriptor = Union[FileDescriptor, "_message.FileDescriptor"]


@dataclass(frozen=True, slots=True)
class MessageSchema:
    """An MCAP schema; of protobuf, `data` is a serialized FileDescriptorSet."""

    name: str
    encoding: str
    data: bytes


def schema_of(descriptor: AnyDescriptor) -> MessageSchema:
    """Schema of a protobuf message type (`syncline_pb2.Emcy.DESCRIPTOR`)."""
    files = FileDescriptorSet()
    for file in _with_dependencies(descriptor.file):
        file.CopyToProto(files.file.add())
    return MessageSchema(descriptor.full_name, PROTOBUF, files.SerializeToString())


def _with_dependencies(file: AnyFileDescriptor) -> list[AnyFileDescriptor]:
    found: dict[str, AnyFileDescriptor] = {}
    for dependency in file.dependencies:
        found |= {each.name: each for each in _with_dependencies(dependency)}
    return [*found.values(), file]


@dataclass(frozen=True, slots=True, eq=False)
class MessageBlock:
    """Messages of one channel, ascending in `log_time_ns`.

    Attributes:
        channel: id that `CaptureWriter.add_channel` returned.
        log_time_ns: (n,) int64, when the recorder took or made the message.
        publish_time_ns: (n,) int64, the stamp closest to the wire.
        length: (n,) int64, bytes of each payload.
        payload: (sum of length,) uint8, the payloads back to back.
    """

    channel: int
    log_time_ns: NDArray[np.int64]
    publish_time_ns: NDArray[np.int64]
    length: NDArray[np.int64]
    payload: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.log_time_ns)

    def split(self, log_ns: int) -> tuple[Self, Self]:
        """The messages before a log time, and those from it on."""
        count = int(np.searchsorted(self.log_time_ns, log_ns))
        size = int(self.length[:count].sum())
        return (
            type(self)(
                self.channel,
                self.log_time_ns[:count],
                self.publish_time_ns[:count],
                self.length[:count],
                self.payload[:size],
            ),
            type(self)(
                self.channel,
                self.log_time_ns[count:],
                self.publish_time_ns[count:],
                self.length[count:],
                self.payload[size:],
            ),
        )

    @classmethod
    def of_messages(
        cls,
        channel: int,
        log_time_ns: Sequence[int] | NDArray[np.int64],
        publish_time_ns: Sequence[int] | NDArray[np.int64],
        messages: Sequence[Message | bytes],
    ) -> Self:
        """A block of rare messages, one by one."""
        payloads = [m if isinstance(m, bytes) else m.SerializeToString() for m in messages]
        return cls(
            channel,
            np.asarray(log_time_ns, np.int64),
            np.asarray(publish_time_ns, np.int64),
            np.array([len(payload) for payload in payloads], np.int64),
            np.frombuffer(b"".join(payloads), np.uint8),
        )

    @classmethod
    def of_rows(
        cls,
        channel: int,
        log_time_ns: NDArray[np.int64],
        publish_time_ns: NDArray[np.int64],
        rows: NDArray[np.uint8],
    ) -> Self:
        """A block of payloads of one length, (n, length) uint8, as `PdoMessage.pack` makes them."""
        length = np.full(len(rows), rows.shape[1], np.int64)
        return cls(channel, log_time_ns, publish_time_ns, length, rows.reshape(-1))
