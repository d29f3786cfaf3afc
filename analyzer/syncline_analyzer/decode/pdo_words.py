"""Words for PDOs: each mapped object with its value and unit."""

from collections.abc import Callable, Sequence

import numpy as np

from syncline_analyzer.decode.part import Rows, Tone, Words
from syncline_analyzer.decode.values import scaled
from syncline_analyzer.views.words import printable
from syncline_schemas.batch import FrameBatch
from syncline_schemas.decoder import PdoMapping, decode_pdo
from syncline_schemas.decoder.pdo import PdoColumn
from syncline_schemas.devices import Device
from syncline_schemas.devices.model import Key

NOT_KNOWN = Words("mapping not known", Tone.PLAIN, opaque=True)
EMPTY = Words("no data")
ASSUMED = "~"
"""Before a value whose scale nobody has read."""


def pdo_words(
    mapping: PdoMapping | None,
    device: Device | None,
    frames: FrameBatch,
    rows: Rows,
    assumed: Callable[[Key], bool],
) -> list[Words]:
    """What each of these frames says by the mapping of its PDO.

    assumed: whether the value of an object, on which a scale may rest, is only assumed.
    """
    if mapping is None:
        return [NOT_KNOWN if length else EMPTY for length in frames.dlc[rows].tolist()]
    columns = decode_pdo(mapping, frames.data[rows], frames.dlc[rows])
    told = [_column_words(column, device, assumed) for column in columns]
    if not told:
        return [EMPTY] * len(rows)
    lines = [", ".join(filter(None, parts)) for parts in zip(*told, strict=True)]
    complete = np.logical_and.reduce([column.valid for column in columns])
    if bool(complete.all()):
        return [Words(line) for line in lines]
    return [
        Words(line) if whole else Words(_short(line), Tone.BAD)
        for line, whole in zip(lines, complete.tolist(), strict=True)
    ]


def _short(line: str) -> str:
    said = "shorter than its mapping"
    return f"{line}, {said}" if line else said


def _column_words(
    column: PdoColumn, device: Device | None, assumed: Callable[[Key], bool]
) -> Sequence[str]:
    """One mapped object in every frame; "" where the frame does not hold it."""
    entry = column.entry
    raw, which = np.unique(column.raw, return_inverse=True)
    facts = device.object(entry.index, entry.sub) if device else None
    rests_on = facts.scale_object if facts is not None else None
    mark = ASSUMED if rests_on is not None and assumed(rests_on) else ""
    unit = f" {entry.unit}" if entry.unit else ""
    words = np.empty(len(raw) + 1, object)
    for at, value in enumerate(raw.tolist()):
        text = f"{printable(entry.name)} {mark}{scaled(value, entry.scale)}{unit}"
        said = facts.describe(value) if facts is not None and isinstance(value, int) else ""
        words[at] = f"{text} ({printable(said)})" if said else text
    words[-1] = ""
    chosen = np.where(column.valid, which, len(raw))
    found: list[str] = words[chosen].tolist()
    return found
