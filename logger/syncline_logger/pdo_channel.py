"""One PDO on its decoded channel: a message type made from its mapping, packed from columns."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from syncline_logger.node_objects import PdoBinding
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.message import MessageBlock, MessageSchema
from syncline_schemas.capture.pdo_message import FieldType, PdoField, PdoMessage
from syncline_schemas.decoder import MappedObject, decode_pdo
from syncline_schemas.decoder.pdo import PdoColumn

_UNREGISTERED = -1

Look = Callable[[Sequence[PdoColumn], NDArray[np.int64], NDArray[np.int64]], None]
"""Takes columns, t_ns and log_ns."""


class PdoChannel:
    """Turns frames of one PDO into messages.

    Attributes:
        metadata: names and units of the fields, and which scales nobody has confirmed.
    """

    def __init__(self, binding: PdoBinding, topic: str) -> None:
        self.binding = binding
        self.topic = topic
        entries = [entry for entry in binding.mapping.entries if entry.kind != "dummy"]
        self._types = [_field_type(entry) for entry in entries]
        self._message = PdoMessage(
            topic.removeprefix("/canopen/").replace("/", "_").replace("-", "_").replace(".", "_"),
            [
                PdoField(entry.name, entry.unit, kind)
                for entry, kind in zip(entries, self._types, strict=True)
            ],
        )
        self.schema: MessageSchema = self._message.schema
        assumed = [entry.name for entry in entries if entry.scale_assumed]
        self.metadata = {
            **self._message.channel_metadata,
            "can_id": f"{binding.can_id:03X}",
            **({"scale_assumed": ", ".join(assumed)} if assumed else {}),
        }
        self._short_reported = False

    def decode(
        self, frames: FrameBatch, log_ns: NDArray[np.int64], look: Look | None = None
    ) -> tuple[MessageBlock | None, str]:
        """Messages of the frames that are long enough, and words about the first that is not.

        look: is shown the columns, with the times of their rows.
        """
        complete = frames.dlc >= self.binding.mapping.length
        problem = "" if complete.all() else self._short(frames.dlc[~complete])
        if not self._types or not complete.any():
            return None, problem
        frames, log_ns = frames[complete], log_ns[complete]
        columns = decode_pdo(self.binding.mapping, frames.data, frames.dlc)
        if look:
            look(columns, frames.t_ns, log_ns)
        values = [
            column.value if kind == "double" else column.raw
            for column, kind in zip(columns, self._types, strict=True)
        ]
        rows = self._message.pack(values)
        return MessageBlock.of_rows(_UNREGISTERED, log_ns, frames.t_ns, rows), problem

    def _short(self, lengths: NDArray[np.uint8]) -> str:
        if self._short_reported:
            return ""
        self._short_reported = True
        return (
            f"{self.topic}: a frame has {int(lengths[0])} bytes,"
            f" the mapping needs {self.binding.mapping.length}; such frames are not decoded"
        )


def _field_type(entry: MappedObject) -> FieldType:
    if entry.kind == "float" or entry.scale != 1:
        return "double"
    if entry.bits == 1:
        return "bool"
    width = "64" if entry.bits > 32 else "32"
    return "int" + width if entry.kind == "signed" else "uint" + width  # type: ignore[return-value]
