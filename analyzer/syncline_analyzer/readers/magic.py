"""The first bytes of captures that are no text."""

from typing import Final

from syncline_schemas.byte_columns import ByteOrder

MCAP_MAGIC: Final = b"\x89MCAP"
ZIP_MAGIC: Final = b"PK\x03\x04"
BLF_MAGIC: Final = b"LOGG"
MF4_MAGIC: Final = (b"MDF     ", b"UnFinMF ")
PCAPNG_MAGIC: Final = b"\x0a\x0d\x0d\x0a"
PCAP_MAGIC: Final[dict[bytes, tuple[ByteOrder, int]]] = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
"""Byte order and what the fraction of a second is counted in [ns]."""
FOREIGN_MAGIC: Final = {
    b"\x34\xcd\xb2\xa1": "a pcap file of a modified kind",
    b"PAR1": "a Parquet file",
    b"SQLite format 3": "an SQLite database",
    b"7z\xbc\xaf": "a 7-Zip archive",
    b"BZh": "a bzip2 file",
    b"\xfd7zXZ": "an xz file",
}
"""Of files that are none."""
BINARY_MAGIC: Final = (
    MCAP_MAGIC,
    ZIP_MAGIC,
    BLF_MAGIC,
    PCAPNG_MAGIC,
    *PCAP_MAGIC,
    *MF4_MAGIC,
    *FOREIGN_MAGIC,
)
