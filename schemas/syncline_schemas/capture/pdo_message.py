"""A protobuf message type made from a PDO's mapping, packed from columns."""

import re
from collections.abc import Sequence
from typing import Literal

import numpy as np
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from numpy.typing import NDArray

from syncline_schemas.capture.layout import PROTOBUF
from syncline_schemas.capture.message import MessageSchema
from syncline_schemas.records import dataclass

FieldType = Literal["double", "float", "int64", "uint64", "int32", "uint32", "bool"]
"""Type of a field; integers are written at full width so that all messages have one length."""

PACKAGE = "syncline.pdo"

_WIRE_FIXED64, _WIRE_FIXED32, _WIRE_VARINT = 1, 5, 0
_FORM: dict[str, tuple["FieldDescriptorProto.Type.ValueType", int, str]] = {
    "double": (FieldDescriptorProto.TYPE_DOUBLE, _WIRE_FIXED64, "<f8"),
    "float": (FieldDescriptorProto.TYPE_FLOAT, _WIRE_FIXED32, "<f4"),
    "int64": (FieldDescriptorProto.TYPE_SFIXED64, _WIRE_FIXED64, "<i8"),
    "uint64": (FieldDescriptorProto.TYPE_FIXED64, _WIRE_FIXED64, "<u8"),
    "int32": (FieldDescriptorProto.TYPE_SFIXED32, _WIRE_FIXED32, "<i4"),
    "uint32": (FieldDescriptorProto.TYPE_FIXED32, _WIRE_FIXED32, "<u4"),
    "bool": (FieldDescriptorProto.TYPE_BOOL, _WIRE_VARINT, "?"),
}


@dataclass(frozen=True, slots=True)
class PdoField:
    """A mapped object: its name, its engineering unit ("" = none) and its type on disk."""

    name: str
    unit: str = ""
    type: FieldType = "double"


class PdoMessage:
    """Message type of a decoded PDO: one always-present field of fixed width per mapped object.

    Attributes:
        schema: the MCAP schema, named `syncline.pdo.<type_name>`.
        field_names: names in the message, made from object name and unit, unique.
        channel_metadata: `unit.<field>` and `object.<field>` of each field, for `add_channel`.
        width: bytes of a payload.
    """

    def __init__(self, type_name: str, fields: Sequence[PdoField]) -> None:
        self.field_names = field_names(fields)
        self.channel_metadata = {
            key: value
            for field, name in zip(fields, self.field_names, strict=True)
            for key, value in ((f"object.{name}", field.name), (f"unit.{name}", field.unit))
            if value
        }
        self._row = _row_dtype(fields)
        self.width = self._row.itemsize
        file = _file_descriptor(_identifier(type_name) or "Pdo", fields, self.field_names)
        self.schema = MessageSchema(
            f"{PACKAGE}.{file.message_type[0].name}",
            PROTOBUF,
            FileDescriptorSet(file=[file]).SerializeToString(),
        )

    def pack(self, columns: Sequence[NDArray[np.generic]]) -> NDArray[np.uint8]:
        """Payloads (n, width) from one column (n,) per field, in the order of the fields."""
        count = len(columns[0]) if columns else 0
        rows = np.empty(count, self._row)
        for number, column in enumerate(columns, start=1):
            rows[f"tag{number}"] = np.frombuffer(_tag(number, self._wire_type(number)), np.uint8)
            rows[f"value{number}"] = column
        return rows.view(np.uint8).reshape(count, self.width)

    def _wire_type(self, number: int) -> int:
        size = self._row[f"value{number}"].itemsize
        return {8: _WIRE_FIXED64, 4: _WIRE_FIXED32, 1: _WIRE_VARINT}[size]


def field_names(fields: Sequence[PdoField]) -> list[str]:
    """Names of the fields in the message: lower case, with the unit, no two alike.

    >>> field_names([PdoField("Position value", "deg"), PdoField("Position value", "deg")])
    ['position_value_deg', 'position_value_deg_2']
    """
    names: list[str] = []
    for field in fields:
        plain = _identifier(field.name).lower() or "value"
        unit = _identifier(_UNIT_WORDS.get(field.unit, field.unit))
        wanted = f"{plain}_{unit}" if unit and not plain.endswith(f"_{unit.lower()}") else plain
        name, copy = wanted, 1
        while name in names:
            copy += 1
            name = f"{wanted}_{copy}"
        names.append(name)
    return names


_UNIT_WORDS = {"°": "deg", "°C": "degC", "%": "percent", "mm/s": "mm_per_s"}


def _identifier(text: str) -> str:
    plain = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_")
    return f"n{plain}" if plain[:1].isdigit() else plain


def _row_dtype(fields: Sequence[PdoField]) -> np.dtype[np.void]:
    parts: list[tuple[str, str, tuple[int, ...]]] = []
    for number, field in enumerate(fields, start=1):
        _, wire, form = _FORM[field.type]
        parts.append((f"tag{number}", "u1", (len(_tag(number, wire)),)))
        parts.append((f"value{number}", form, ()))
    return np.dtype(parts)


def _tag(number: int, wire_type: int) -> bytes:
    key = number << 3 | wire_type
    return bytes([key]) if key < 0x80 else bytes([key & 0x7F | 0x80, key >> 7])


def _file_descriptor(
    type_name: str, fields: Sequence[PdoField], names: Sequence[str]
) -> FileDescriptorProto:
    message = DescriptorProto(name=type_name)
    for number, (field, name) in enumerate(zip(fields, names, strict=True), start=1):
        message.field.add(
            name=name,
            number=number,
            label=FieldDescriptorProto.LABEL_OPTIONAL,
            type=_FORM[field.type][0],
            proto3_optional=True,
            oneof_index=number - 1,
        )
        message.oneof_decl.add(name=f"_{name}")
    return FileDescriptorProto(
        name=f"syncline/pdo/{type_name}.proto",
        package=PACKAGE,
        message_type=[message],
        syntax="proto3",
    )
