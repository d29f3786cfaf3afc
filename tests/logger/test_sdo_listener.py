"""SDO frames in the light of their transfer; all bytes written from CiA 301 7.2.4.3."""

import numpy as np

from syncline_logger.sdo_listener import SdoListener, SdoPass
from syncline_schemas.batch import FrameBatch

Frame = tuple[str, str]
"""("c" | "s", hex bytes): who sent it."""


def listen(*frames: Frame, node: int = 5) -> SdoPass:
    rows = [
        (n, 0, (0x600 if sender == "c" else 0x580) + node, 0, len(data), data)
        for n, (sender, data) in enumerate((s, bytes.fromhex(h)) for s, h in frames)
    ]
    batch = FrameBatch.from_rows(rows)
    return SdoListener().update(batch, np.arange(len(batch)))


def learned(*frames: Frame) -> list[tuple[int, int, bytes, bool]]:
    return [(v.index, v.sub, v.data, v.written) for v in listen(*frames).learned]


READ_1000 = ("c", "40 00 10 00 00 00 00 00")


def test_an_answered_expedited_read() -> None:
    done = listen(READ_1000, ("s", "43 00 10 00 96 01 02 00"))
    [value] = done.learned
    assert (value.row, value.node, value.index, value.sub) == (1, 5, 0x1000, 0)
    assert (value.data, value.written) == (bytes.fromhex("96010200"), False)


def test_a_confirmed_expedited_write() -> None:
    assert learned(("c", "2F 00 18 02 01 00 00 00"), ("s", "60 00 18 02 00 00 00 00")) == [
        (0x1800, 2, b"\x01", True)
    ]


def test_a_write_counts_only_when_it_is_confirmed() -> None:
    write = ("c", "2F 00 18 02 01 00 00 00")
    assert learned(write) == []
    assert learned(write, ("s", "80 00 18 02 30 00 09 06")) == []
    assert learned(write, ("s", "60 00 18 03 00 00 00 00")) == []


def test_an_answer_without_a_request_reveals_nothing() -> None:
    assert learned(("s", "43 00 10 00 96 01 02 00")) == []


def test_a_segmented_read() -> None:
    assert learned(
        ("c", "40 08 10 00 00 00 00 00"),
        ("s", "41 08 10 00 0A 00 00 00"),
        ("c", "60 00 00 00 00 00 00 00"),
        ("s", "00 4C 49 52 2D 44 41 31"),
        ("c", "70 00 00 00 00 00 00 00"),
        ("s", "19 35 38 41 00 00 00 00"),
    ) == [(0x1008, 0, b"LIR-DA158A", False)]


BLOCK_UPLOAD = (
    ("c", "A4 08 10 00 04 00 00 00"),  # initiate, CRC, blocks of 4 segments
    ("s", "C6 08 10 00 1C 00 00 00"),  # 28 bytes
    ("c", "A3 00 00 00 00 00 00 00"),  # start
    ("s", "01 40 41 42 43 44 45 46"),
    ("s", "02 47 48 49 4A 4B 4C 4D"),
    ("s", "03 4E 4F 50 51 52 53 54"),
    ("s", "84 55 56 57 58 59 5A 5B"),  # the last one: three tools call this an abort
    ("c", "A2 04 04 00 00 00 00 00"),
    ("s", "C1 00 00 00 00 00 00 00"),  # end
    ("c", "A1 00 00 00 00 00 00 00"),
)


def test_block_upload_segments_are_data() -> None:
    done = listen(*BLOCK_UPLOAD)
    assert np.flatnonzero(done.segment).tolist() == [3, 4, 5, 6]
    assert not done.learned


def test_a_transfer_after_a_block_upload() -> None:
    assert learned(*BLOCK_UPLOAD, READ_1000, ("s", "43 00 10 00 96 01 02 00")) == [
        (0x1000, 0, bytes.fromhex("96010200"), False)
    ]


def test_a_lost_last_segment_comes_again() -> None:
    done = listen(
        *BLOCK_UPLOAD[:7],
        ("c", "A2 03 04 00 00 00 00 00"),  # only three arrived
        ("s", "81 55 56 57 58 59 5A 5B"),
        ("c", "A2 01 04 00 00 00 00 00"),
        ("s", "C1 00 00 00 00 00 00 00"),
        ("c", "A1 00 00 00 00 00 00 00"),
    )
    assert np.flatnonzero(done.segment).tolist() == [3, 4, 5, 6, 8]


def test_block_download_segments_are_data() -> None:
    done = listen(
        ("c", "C6 50 1F 01 0E 00 00 00"),
        ("s", "A4 50 1F 01 7F 00 00 00"),
        ("c", "01 80 81 82 83 84 85 86"),
        ("c", "82 80 81 82 83 84 85 86"),
        ("s", "A2 02 7F 00 00 00 00 00"),
        ("c", "C1 34 12 00 00 00 00 00"),
        ("s", "A1 00 00 00 00 00 00 00"),
    )
    assert np.flatnonzero(done.segment).tolist() == [2, 3]


def test_an_abort_among_block_segments_is_an_abort() -> None:
    done = listen(
        *BLOCK_UPLOAD[:4],
        ("s", "80 08 10 00 00 00 04 05"),
        ("s", "85 47 48 49 4A 4B 4C 4D"),
    )
    assert np.flatnonzero(done.segment).tolist() == [3]


def test_nodes_do_not_mix() -> None:
    rows = [
        (0, 0, 0x605, 0, 8, bytes.fromhex("4000100000000000")),
        (1, 0, 0x586, 0, 8, bytes.fromhex("4300100096010200")),
    ]
    batch = FrameBatch.from_rows(rows)
    assert SdoListener().update(batch, np.arange(2)).learned == []


def test_short_and_odd_frames_never_raise() -> None:
    rng = np.random.default_rng(1)
    frames: list[Frame] = [
        ("cs"[int(rng.integers(2))], rng.bytes(int(rng.integers(0, 9))).hex()) for _ in range(3000)
    ]
    listen(*frames)
