"""What a recorder had learned of nodes' settings before a segment, as a metadata record."""

import re
from collections.abc import Mapping

Key = tuple[int, int]
Settings = Mapping[Key, tuple[bytes, bool]]
"""Bytes of objects by (index, sub), each with whether the node keeps them over a reset."""

_UNSAVED = "*"
_PLACE = re.compile(r"(\d+)/(\d+)/([0-9A-F]{4}):([0-9A-F]{2})")


def learned_record(settings: Mapping[tuple[int, int], Settings]) -> dict[str, str]:
    r"""The record for settings by (bus number, node).

    >>> learned_record({(0, 5): {(0x1800, 2): (b"\x01", True), (0x1017, 0): (b"\x64\0", False)}})
    {'0/5/1800:02': '01', '0/5/1017:00': '6400*'}
    """
    return {
        f"{bus}/{node}/{index:04X}:{sub:02X}": data.hex() + ("" if kept else _UNSAVED)
        for (bus, node), known in settings.items()
        for (index, sub), (data, kept) in known.items()
    }


def learned_settings(
    record: Mapping[str, str],
) -> dict[tuple[int, int], dict[Key, tuple[bytes, bool]]]:
    """Settings by (bus number, node) of a record; what cannot be read is left out."""
    found: dict[tuple[int, int], dict[Key, tuple[bytes, bool]]] = {}
    for place, text in record.items():
        match = _PLACE.fullmatch(place)
        try:
            data = bytes.fromhex(text.removesuffix(_UNSAVED))
        except ValueError:
            continue
        if match:
            node = found.setdefault((int(match[1]), int(match[2])), {})
            node[int(match[3], 16), int(match[4], 16)] = (data, not text.endswith(_UNSAVED))
    return found
