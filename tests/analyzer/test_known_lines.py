"""Lines of known layouts read by the compiled loop: the same as by numpy, whatever stands in them."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from syncline_analyzer.readers.asc import AscFormat
from syncline_analyzer.readers.candump import CandumpFormat
from syncline_analyzer.readers.lines import LineFormat, TextReader
from syncline_schemas import native
from syncline_schemas.batch import FrameBatch

pytestmark = pytest.mark.skipif(not native.available(), reason="the library was not built")

LINES = [
    b"(1760000000.000004) can0 080#",
    b"(1760000000.100427) can0 181#0011aaFF",
    b"(1760000001.900718) can1 182#0123456789ABCDEF",
    b"(1760000001.900719) can0 1ABCDEF2#0102030405060708",
    b"(1760000001.900720) can0 701#R",
    b"(1760000002.000000) can0 123##1" + b"5A" * 64,
    b"(1760000002.000000) can0 123##1" + b"5A" * 12,
    b"(0000000002.5) can0 123#11.22.33",
    b" can0  181   [3]  11 22 33",
    b" (000.200000)  can0  1B1   [8]  11 22 33 44 55 66 77 88",
]
ASC = [
    b"   0.000200 1  181             Rx   d 4 00 11 22 33",
    b"   0.100200 1  281             Rx   d 8 00 11 22 33 44 55 66 77  Length = 240000 BitCount = 125",
    b"   1.200200 2  18FEDF0Ax       Tx   d 8 FF 11 22 33 44 55 66 77",
]


def read(path: Path, form: type[LineFormat], block_bytes: int) -> tuple[list[object], object]:
    """Everything that is told of a log."""
    reader = TextReader(path, form(path), block_bytes=block_bytes)  # type: ignore[arg-type]
    found: list[object] = []
    for item in reader.batches():
        if isinstance(item, FrameBatch):
            columns = (item.t_ns, item.bus, item.can_id, item.flags, item.dlc, item.data)
            found.append([(column.dtype, column.shape, column.tolist()) for column in columns])
        else:
            found.append(item)
    facts = reader.facts
    return found, (facts.buses, facts.unparsed_lines, facts.notes, facts.resolution_ns)


def both(
    path: Path, text: bytes, form: type[LineFormat] = CandumpFormat, block_bytes: int = 1 << 21
) -> None:
    path.write_bytes(text)
    compiled = read(path, form, block_bytes)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "available", lambda: False)
        assert read(path, form, block_bytes) == compiled


@pytest.mark.parametrize("line", LINES)
def test_every_character_in_every_place(tmp_path: Path, line: bytes) -> None:
    changed = [
        line[:at] + bytes([byte]) + line[at + 1 :]
        for at in range(len(line))
        for byte in (range(256) if at < 50 else (0x2F, 0x3A, 0x40, 0x47, 0x60, 0x67, 0xB0))
        if byte not in b"\r\n"
    ]
    both(tmp_path / "a.log", b"\n".join([line] * 3 + changed), block_bytes=1 << 14)


@pytest.mark.parametrize("line", ASC)
def test_layouts_of_other_formats(tmp_path: Path, line: bytes) -> None:
    head = b"date Mon Mar 2 10:00:00.000 am 2026\nbase hex  timestamps absolute\n"
    rng = np.random.default_rng(3)
    lines = []
    for _ in range(400):
        other = bytearray(line)
        for at in rng.integers(0, len(line), int(rng.integers(0, 3))).tolist():
            other[at] = int(rng.choice(list(b"0123456789abcdefABCDEFxg .:")))
        lines.append(bytes(other))
    both(tmp_path / "a.asc", head + b"\n".join([line, *lines]) + b"\n", AscFormat, 1 << 12)


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    st.lists(
        st.sampled_from(LINES)
        | st.tuples(
            st.sampled_from(LINES), st.integers(0, 60), st.binary(min_size=1, max_size=3)
        ).map(lambda c: c[0][: c[1]] + c[2] + c[0][c[1] + len(c[2]) :])
        | st.binary(max_size=40),
        max_size=60,
    ),
    st.sampled_from([200, 1000, 1 << 20]),
    st.booleans(),
)
def test_logs_of_odd_lines(
    tmp_path: Path, lines: list[bytes], block_bytes: int, ended: bool
) -> None:
    both(tmp_path / "a.log", b"\n".join(lines) + b"\n" * ended, CandumpFormat, block_bytes)


def test_a_log_of_a_few_characters(tmp_path: Path) -> None:
    for text in (b"", b"\n", b"\n\n", b"x", b"x\n", b"1 181#\n" * 3):
        both(tmp_path / "a.log", text)
