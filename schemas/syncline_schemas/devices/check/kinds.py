"""Every kind of fault that a check names: how bad it is, what to write, what our reader makes of it.

error: a tool that believes the file goes wrong. warning: it contradicts the standard, and some tool
stumbles. note: unusual, or worth a look. The rules are those of CiA 301, CiA 306 and CiA 311.
"""

from typing import Literal

from syncline_schemas.records import dataclass

Severity = Literal["error", "warning", "note"]
SEVERITIES: tuple[Severity, ...] = ("error", "warning", "note")
"""The worst first."""


@dataclass(frozen=True, slots=True)
class FaultKind:
    """`write`: what to write instead. `reading`: what our reader does, "" where it takes it as is."""

    severity: Severity
    write: str
    reading: str = ""


_HEX = "write a decimal number, or hexadecimal digits after 0x"

KINDS: dict[str, FaultKind] = {
    # text
    "byte_order_mark": FaultKind("note", "save the file without a byte order mark", "mark skipped"),
    "encoding": FaultKind(
        "note",
        "save the file as ASCII: CiA 306 knows no other characters, and tools guess differently",
    ),
    "xml": FaultKind("error", "repair the XML at the place named", "nothing read"),
    "untold": FaultKind("warning", "repair the faults that are told first"),
    "bracket": FaultKind("warning", "close the section's name with ]", "section read"),
    "section_tail": FaultKind("note", "leave nothing but the section's name on its line", "ignored"),
    "duplicate_section": FaultKind(
        "error", "describe each object and each section once: delete or renumber one of them",
        "the first one counts, keys that only the second has are added",
    ),
    "duplicate_key": FaultKind(
        "warning", "leave one of the two lines", "the first one counts"
    ),
    "stray_line": FaultKind(
        "warning", "write key=value, or begin the line with ; to make it a comment", "ignored"
    ),
    "colon": FaultKind("warning", "write key=value", "read as if it were ="),
    "inline_comment": FaultKind(
        "note", "put the comment on a line of its own that begins with ;: other readers take it for a "
        "part of the value", "comment dropped",
    ),
    "unknown_section": FaultKind("note", "delete it, or correct its name", "ignored"),
    "missing_section": FaultKind("warning", "add the section: CiA 306 4.3 to 4.6 ask for it"),
    # general sections
    "device_info_number": FaultKind("warning", _HEX, "not used"),
    "device_info_empty": FaultKind("note", "write the number; 0 where there is none", "not used"),
    "device_info_missing": FaultKind("note", "add the keys to [DeviceInfo] (CiA 306 4.4)"),
    "baud_rates": FaultKind(
        "warning", "write 1 for each BaudRate_... that the device knows, 0 for the others"
    ),
    "baud_rate_set": FaultKind(
        "warning", "set a bit rate that the device knows, or write 1 for it in [DeviceInfo]"
    ),
    "granularity": FaultKind(
        "warning", "write 0 (mapping is fixed) to 64: the smallest mappable piece in bits, mostly 8"
    ),
    "pdo_count": FaultKind(
        "warning", "let NrOfRXPDO and NrOfTXPDO in [DeviceInfo] say how many PDOs are described"
    ),
    "identity": FaultKind(
        "warning", "write the same number in [DeviceInfo] and as default of 1018h",
        "1018h counts, [DeviceInfo] where 1018h says nothing",
    ),
    "revision": FaultKind(
        "note", "write the same number in [DeviceInfo] and as default of 1018h:03"
    ),
    "file_info": FaultKind("note", "write it as CiA 306 4.3 asks"),
    "dummy_missing": FaultKind(
        "note", "add Dummy0001 to Dummy0007 with 1 or 0", "taken as not mappable"
    ),
    "dummy_unknown": FaultKind("note", "delete the line: only data types can be dummies", "ignored"),
    "commissioning": FaultKind(
        "warning", "write NodeID from 1 to 127 and Baudrate in kbit/s, like 250",
        "bit/s made kbit/s; what makes no sense is not used",
    ),
    "commissioning_missing": FaultKind(
        "warning", "add [DeviceComissioning] with NodeID and Baudrate: that is what makes it a DCF"
    ),
    "commissioning_name": FaultKind(
        "note", "write [DeviceComissioning]: the standard spells it with one m", "read"
    ),
    "value_in_eds": FaultKind(
        "note", "save it as a .dcf or .xdc: an EDS or XDD has defaults only", "the set value counts"
    ),
    "comment_lines": FaultKind("note", "let Lines say how many Line1, Line2 ... there are"),
    # lists of objects
    "list_count": FaultKind(
        "warning", "let SupportedObjects say how many objects the list has", "all of them read"
    ),
    "list_numbers": FaultKind(
        "warning", "number the list 1, 2, 3 ...: many readers stop at the first hole", "all read"
    ),
    "list_wrong": FaultKind(
        "note",
        "list 1000h, 1001h and 1018h under [MandatoryObjects], 2000h to 5FFFh under "
        "[ManufacturerObjects], all others under [OptionalObjects]",
        "read",
    ),
    "list_twice": FaultKind("note", "list each object once", "read once"),
    "listed_missing": FaultKind(
        "error", "describe these objects in sections of their own, or take them off the list",
        "they are unknown",
    ),
    "unlisted": FaultKind(
        "warning", "list them: readers that follow the lists miss these objects", "read all the same"
    ),
    # objects
    "mandatory": FaultKind("error", "describe the object: CiA 301 asks every device for it"),
    "identity_missing": FaultKind(
        "warning", "describe 1018h with the vendor id at least: mandatory since CiA 301 4.0"
    ),
    "error_control": FaultKind(
        "warning", "describe 1017h (heartbeat), or 100Ch and 100Dh (guarding), as CiA 301 7.2.8 asks"
    ),
    "head_missing": FaultKind(
        "error", "add the object's own section with ParameterName, ObjectType and SubNumber",
        "taken as a record",
    ),
    "sub_number": FaultKind(
        "warning", "write how many subindexes are described, subindex 0 counted",
        "all that are described are read",
    ),
    "sub0_missing": FaultKind(
        "warning", "describe subindex 0, an UNSIGNED8 with the highest subindex as its default"
    ),
    "sub0_type": FaultKind("warning", "write DataType=0x0005: subindex 0 is an UNSIGNED8"),
    "sub0_value": FaultKind("warning", "write the highest subindex as the default of subindex 0"),
    "object_type": FaultKind(
        "error", "write 0x7 (variable), 0x8 (array), 0x9 (record) or 0x2 (domain)",
        "taken as a variable, as a record where it has subindexes",
    ),
    "object_type_subs": FaultKind(
        "error", "write ObjectType=0x9 (record) or 0x8 (array)", "taken as a record"
    ),
    "no_subs": FaultKind("warning", "describe its subindexes, or write ObjectType=0x7", "a variable"),
    "object_kind": FaultKind("error", "describe it as CiA 301 7.5.2 does"),
    "name_missing": FaultKind("warning", "write a ParameterName", "named by its index"),
    "data_type": FaultKind(
        "error", "write the DataType, like 0x0007 for UNSIGNED32", "values stay bytes"
    ),
    "data_type_unknown": FaultKind(
        "error", "write one of the data types of CiA 301 table 44", "values stay bytes"
    ),
    "standard_type": FaultKind("error", "write the data type that CiA 301 gives this object"),
    "standard_access": FaultKind("note", "write AccessType=ro or const"),
    "access_type": FaultKind("warning", "write ro, wo, rw, rwr, rww or const", "taken as rw"),
    "no_parameter": FaultKind(
        "error", "give the object a dataType and accessType, or describe the parameter",
        "values stay bytes",
    ),
    "several_devices": FaultKind("note", "keep one device per file", "the first device is read"),
    "value": FaultKind("error", _HEX, "not used"),
    "value_range": FaultKind("warning", "write a value that the data type can hold"),
    "octal": FaultKind(
        "warning", "write it without the leading 0: with it readers disagree about the value",
        "read as octal, as in C",
    ),
    "limits_order": FaultKind("warning", "let LowLimit be the smaller one"),
    "outside_limits": FaultKind("warning", "correct the value or the limits"),
    "mappable_type": FaultKind(
        "note", "write PDOMapping=0, unless its values never have more than 8 bytes"
    ),
    # node ids and identifiers
    "node_id": FaultKind("error", "write it as $NODEID+0x180", "not used"),
    "node_id_form": FaultKind(
        "note", "write it as $NODEID+0x180: capitals, $NODEID first (CiA 306 4.6.3)", "understood"
    ),
    "cob_id_node": FaultKind("warning", "write $NODEID+ before the number"),
    "cob_id_fixed": FaultKind("note", "write $NODEID+ and the base, unless it is fixed in the device"),
    "cob_id_unusual": FaultKind(
        "note", "the predefined connection set (CiA 301 7.3.5) has another identifier; right if the "
        "device's manual says so",
    ),
    "cob_id_restricted": FaultKind(
        "error", "use an identifier that CiA 301 7.3.5 does not restrict; set bit 31 to switch off"
    ),
    "cob_id_bits": FaultKind("error", "bits 11 to 28 belong to 29-bit identifiers: set bit 29, or clear"),
    "cob_id_twice": FaultKind("warning", "give each PDO that is on an identifier of its own"),
    # PDOs
    "pdo_pair": FaultKind("error", "describe both records of a PDO, parameter and mapping"),
    "transmission": FaultKind("warning", "use 0 to 240 or 252 to 255: the others are reserved"),
    "mapping_missing": FaultKind(
        "error", "map an object that is described, or describe it", "the bits stay unnamed"
    ),
    "mapping_length": FaultKind(
        "error", "write the length of the object's data type in the last two digits, like ...20 for "
        "32 bits", "the mapped bits are read, with the sign of the data type",
    ),
    "mapping_too_long": FaultKind("error", "map 64 bits at most: a PDO has 8 bytes"),
    "mapping_count": FaultKind("warning", "let subindex 0 say how many entries are mapped"),
    "mapping_empty": FaultKind("warning", "lower subindex 0, or map an object there"),
    "mapping_not_allowed": FaultKind("warning", "write PDOMapping=1 for the mapped object"),
    "mapping_direction": FaultKind(
        "error", "a TPDO sends what can be read, an RPDO sets what can be written: correct AccessType "
        "or the mapping",
    ),
    "mapping_granularity": FaultKind(
        "note", "map multiples of the granularity, or lower Granularity in [DeviceInfo]"
    ),
    "dummy_tpdo": FaultKind(
        "error", "dummies pad RPDOs only: map an object of the device", "the bits are skipped"
    ),
    "dummy_forbidden": FaultKind(
        "warning", "write 1 for this data type in [DummyUsage], or do not map it",
        "the bits are skipped",
    ),
}  # fmt: skip
"""By name; the names stay."""
