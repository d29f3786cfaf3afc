"""Decoded frames as JSON lines: one object a frame."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from syncline_analyzer.decode.part import Part, Rows
from syncline_analyzer.decode.stream import DecodedBatch, Decoding
from syncline_analyzer.views.decode_lines import in_order
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap


class DecodedJson:
    """Writes decoded batches as JSON lines; identifiers are integers, bytes are hexadecimal."""

    def __init__(self, decoding: Decoding) -> None:
        self._decoding = decoding

    def lines(self, item: DecodedBatch | Gap) -> list[str]:
        """The lines of a batch in the order of its frames, or that of a gap."""
        if isinstance(item, Gap):
            return [self._gap(item)]
        texts, rows = in_order(item.parts, len(item.batch), self._texts(item))
        seqs, times = item.batch.seqs_at(rows).tolist(), item.batch.frames.t_ns[rows].tolist()
        if not self._decoding.timed:
            times = ["null"] * len(seqs)
        return [
            f'{{"seq": {seq}, "t_ns": {t_ns}, {text}'
            for seq, t_ns, text in zip(seqs, times, texts, strict=True)
        ]

    def _texts(self, item: DecodedBatch) -> Iterator[list[str]]:
        frames = item.batch.frames
        for part in item.parts:
            head = self._head(part)
            yield [
                json.dumps({**head, "flags": _flags(flags), "data": data, "text": words.text})[1:]
                for flags, data, words in zip(
                    frames.flags[part.first].tolist(),
                    _bytes(frames, part.first),
                    part.words,
                    strict=True,
                )
            ]

    def _head(self, part: Part) -> dict[str, Any]:
        head = part.head
        return {
            "bus": self._decoding.bus_name(head.bus),
            "cob_id": head.can_id,
            "family": head.family,
            "service": head.service,
            "node": head.node,
        }

    def _gap(self, gap: Gap) -> str:
        return json.dumps(
            {
                "gap": gap.reason,
                "bus": None if gap.bus is None else self._decoding.bus_name(gap.bus),
                "start_ns": gap.start_ns,
                "end_ns": gap.end_ns,
                "lost_frames": gap.lost_frames,
            }
        )


def _flags(flags: int) -> list[str]:
    return [str(flag.name).lower() for flag in FrameFlag if flags & flag] if flags else []


def _bytes(frames: FrameBatch, rows: Rows) -> list[str]:
    """Bytes of frames in hexadecimal, without blanks."""
    width = 2 * frames.data.shape[1]
    written = frames.data[rows].tobytes().hex()
    remote = frames.flags[rows] & np.uint16(FrameFlag.REMOTE) != 0
    lengths = np.where(remote, 0, frames.dlc[rows]).tolist()
    return [written[at * width : at * width + 2 * length] for at, length in enumerate(lengths)]
