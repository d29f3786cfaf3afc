"""Lines of a log that cannot be read are a hole: what is missing there may be in them."""

from pathlib import Path

import pytest

from syncline_analyzer import open_session
from syncline_analyzer.capture import Unread
from syncline_analyzer.readers import open_capture
from tests.analyzer.whole_run import beats, every, ids

SPOILT = (b"(1000000010.0", b"other words", b"(1000000010.004) can0 18")


def lines() -> list[bytes]:
    """A candump log of 20 s: SYNC of 20 ms, two PDOs that answer it, heartbeats."""
    rows = sorted(
        [
            *every(0x80, 1, 20_000, 20),
            *every(0x185, 2, 20_000, 20, b"\1\2"),
            *every(0x186, 2.3, 20_000, 20, b"\3"),
            *beats(5, 7, 20_000, 100.013),
            *beats(6, 11, 20_000, 200.021),
        ]
    )
    return [
        b"(%.6f) can0 %03X#%s" % (1_000_000_000 + t_ns / 1e9, can_id, data.hex().upper().encode())
        for t_ns, _, can_id, _, _, data in rows
    ]


def written(tmp_path: Path, told: list[bytes]) -> Path:
    """The lines as a log."""
    path = tmp_path / "run.log"
    path.write_bytes(b"\n".join(told) + b"\n")
    return path


@pytest.mark.near_miss("pdo.missed")
@pytest.mark.near_miss("sync.missing")
@pytest.mark.parametrize("text", SPOILT)
@pytest.mark.parametrize("cob_id", [b"080#", b"185#", b"186#"])
def test_a_frame_that_may_be_in_an_unread_line_is_not_missing(
    tmp_path: Path, cob_id: bytes, text: bytes
) -> None:
    told = lines()
    for place in (300, 900):
        spoilt = next(k for k in range(place, len(told)) if cob_id in told[k])
        told[spoilt] = text
    analysis = open_session(written(tmp_path, told)).analyze()
    assert ids(analysis) == {"capture.unparsed"}
    assert (analysis.sync[0].missing, sum(row.missed for row in analysis.pdos)) == (0, 0)


@pytest.mark.triggers("pdo.missed")
@pytest.mark.triggers("sync.missing")
def test_what_is_missing_elsewhere_or_beyond_is_told(tmp_path: Path) -> None:
    told = lines()
    syncs = [k for k, line in enumerate(told) if b"080#" in line]
    pdo = next(k for k in range(1500, len(told)) if b"186#" in told[k])
    told[pdo] = b""
    for k in syncs[300:305]:
        told[k] = b"" if k != syncs[302] else b"spoilt"
    analysis = open_session(written(tmp_path, told)).analyze()
    assert {"sync.missing", "pdo.missed"} <= ids(analysis)


@pytest.mark.parametrize("block_bytes", [97, 4096, 1 << 20])
def test_a_reader_knows_between_which_frames_a_line_could_not_be_read(
    tmp_path: Path, block_bytes: int
) -> None:
    path = written(
        tmp_path,
        [
            b"(1.000000) can0 080#",
            b"words",
            b"more",
            b"(1.020000) can0 080#",
            b"(1.040000) can0 080#",
        ],
    )
    reader = open_capture(path, block_bytes=block_bytes)
    list(reader.batches())
    assert reader.facts.unread == [Unread(1_000_000_000, 1_020_000_000, 2)]
