"""What a recorder knew besides its frames arrives in the converted capture, or is counted as lost."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from syncline_analyzer.convert import convert
from syncline_analyzer.info import inspect
from syncline_analyzer.readers import open_capture
from syncline_analyzer.writers.formats import ADAPTERS, LEARNED
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.adapter_fit import AdapterFit
from syncline_schemas.capture.layout import (
    CLOCK_TOPIC,
    LEARNED_METADATA_NAME,
    BusInfo,
    CaptureMetadata,
)
from syncline_schemas.capture.learned import Settings, learned_record
from syncline_schemas.capture.message import MessageBlock, schema_of
from syncline_schemas.capture.writer import CaptureWriter
from syncline_schemas.proto import syncline_pb2
from tests.analyzer.log_builder import T0_NS, row

SETTINGS: Settings = {(0x1800, 2): (b"\x01", True), (0x1017, 0): (b"\x64\0", False)}
RESIDUALS_NS = (80_000, 2_000, 3_000)


def _segment(
    path: Path,
    *,
    buses: tuple[str, ...] = ("can0", "can1"),
    recording: str = "abc",
    begin_us: int = 0,
    learned: Mapping[tuple[int, int], Settings] | None = None,
    adapter_bus: int | None = None,
) -> Path:
    with path.open("wb") as file:
        writer = CaptureWriter(
            file,
            CaptureMetadata("1", recording, created_ns=T0_NS + 1000 * begin_us),
            [BusInfo(name, number) for number, name in enumerate(buses)],
        )
        if learned:
            writer.add_metadata(LEARNED_METADATA_NAME, learned_record(learned))
        for number, residual_ns in enumerate(RESIDUALS_NS if adapter_bus is not None else ()):
            sample = syncline_pb2.ClockSample(
                bus=adapter_bus, adapter_ns=number, residual_ns=residual_ns, rate_ppb=-350
            )
            payload = sample.SerializeToString()
            channel = writer.add_channel(
                CLOCK_TOPIC, schema_of(syncline_pb2.ClockSample.DESCRIPTOR)
            )
            at_ns = np.array([T0_NS + number], np.int64)
            length = np.array([len(payload)], np.int64)
            block = MessageBlock(channel, at_ns, at_ns, length, np.frombuffer(payload, np.uint8))
            writer.write_chunk(FrameBatch.empty(), messages=[block])
        writer.write_frames(
            FrameBatch.from_rows([row(begin_us, 0x181, b"\1", bus=b) for b in range(len(buses))])
        )
        writer.finish()
    return path


def _learned(path: Path) -> Mapping[tuple[int, int], Settings]:
    reader = open_capture(path)
    list(reader.batches())
    return reader.facts.learned


def test_what_earlier_segments_revealed_is_carried(tmp_path: Path) -> None:
    source = _segment(tmp_path / "a.mcap", learned={(0, 5): SETTINGS, (1, 6): SETTINGS})
    result = convert([source], tmp_path / "x.mcap")
    assert _learned(result.output) == {(0, 5): SETTINGS, (1, 6): SETTINGS}
    assert result.complete


def test_of_several_segments_the_earliest_tells_whatever_the_order(tmp_path: Path) -> None:
    first = _segment(tmp_path / "a.mcap", begin_us=0, learned={(0, 5): SETTINGS})
    second = _segment(tmp_path / "b.mcap", begin_us=9, learned={(0, 7): SETTINGS})
    result = convert([second, first], tmp_path / "x.mcap")
    assert _learned(result.output) == {(0, 5): SETTINGS}
    assert result.complete
    plain = _segment(tmp_path / "c.mcap", begin_us=0)
    result = convert([second, plain], tmp_path / "y.mcap")
    assert _learned(result.output) == {}
    assert result.complete, "the frames of the first tell what the second knew"


def test_of_several_recordings_nothing_is_carried_and_that_is_told(tmp_path: Path) -> None:
    first = _segment(tmp_path / "a.mcap", learned={(0, 5): SETTINGS})
    other = _segment(tmp_path / "b.mcap", recording="xyz", begin_us=9, learned={(0, 7): SETTINGS})
    result = convert([first, other], tmp_path / "x.mcap")
    assert _learned(result.output) == {}
    assert result.lost == {LEARNED: 4}


def test_how_well_adapters_clocks_were_known_is_carried(tmp_path: Path) -> None:
    source = _segment(tmp_path / "a.mcap", adapter_bus=1)
    fits = {"can1": AdapterFit(3, 3_000, 80_000, -350)}
    assert inspect(source).adapter_fits == fits
    result = convert([source], tmp_path / "x.mcap")
    assert inspect(result.output).adapter_fits == fits
    assert result.complete
    again = convert([result.output], tmp_path / "y.mcap")
    assert inspect(again.output).adapter_fits == fits


def test_other_formats_count_what_they_cannot_hold(tmp_path: Path) -> None:
    source = _segment(tmp_path / "a.mcap", learned={(0, 5): SETTINGS}, adapter_bus=0)
    result = convert([source], tmp_path / "x.log")
    assert result.lost == {LEARNED: 2, ADAPTERS: 1}
