"""The chains of blocks of an ASAM MDF 4 file, which in a damaged one may have no end.

Source: ASAM MDF 4.1, "Block structure": id, reserved, length, number of links, links.
"""

import struct
from typing import BinaryIO, Final

_HEAD_BYTES: Final = 24
_LINKS: Final = 6
_HD_ADDRESS: Final = 64
_NEXT: Final = {
    "HD": ("DG", "FH", "CH", "AT", "EV"),
    "DG": ("", "CG", "data"),
    "CG": ("", "CN"),
    "CN": ("", "CN", "", "", "", "data"),
    "CH": ("", "CH"),
}
"""By kind of block: the kinds of the chains that its links begin."""
_DATA: Final = {b"##HL": ("data",), b"##DL": (), b"##LD": ()}
"""Of the kinds of data the ones that are chains, or lead to one."""


def has_endless_chain(file: BinaryIO) -> bool:
    """Whether some chain of blocks leads back to a block of its own; the file's place is kept.

    What kind a block is follows from where the link to it stands: so do readers take it, whatever
    stands in it.
    """
    place = file.tell()
    started: set[tuple[str, int]] = set()
    waiting = [("HD", _HD_ADDRESS)]
    try:
        while waiting:
            start = waiting.pop()
            if start in started:
                continue
            started.add(start)
            kind, address = start
            met: set[int] = set()
            while address:
                if address in met:
                    return True
                met.add(address)
                mark, links = _block(file, address)
                begun = _DATA.get(mark, ()) if kind == "data" else _NEXT.get(kind, ())
                waiting += [
                    (what, to) for what, to in zip(begun, links, strict=False) if what and to
                ]
                chained = kind not in ("HD", "data") or mark in (b"##DL", b"##LD")
                address = links[0] if chained and links else 0
        return False
    finally:
        file.seek(place)


def _block(file: BinaryIO, address: int) -> tuple[bytes, tuple[int, ...]]:
    """Mark and first links of the block at an address; nothing where none can be."""
    try:
        file.seek(address)
    except (OSError, ValueError):  # further than any file reaches
        return b"", ()
    raw = file.read(_HEAD_BYTES + 8 * _LINKS)
    links = raw[_HEAD_BYTES:]
    return raw[:4], struct.unpack(f"<{len(links) // 8}Q", links[: len(links) // 8 * 8])
