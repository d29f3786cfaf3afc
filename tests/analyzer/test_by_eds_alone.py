"""Encoders of CiA 406 and inclinometers of CiA 410 of which nothing is known but their EDS."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from tests.analyzer.traps.script import Script, Told, says

U8, U16, U32, I16, I32 = 0x05, 0x06, 0x07, 0x03, 0x04
Objects = Mapping[tuple[int, int], tuple[str, int, int | None]]
"""(index, sub) -> name, data type, default."""


def eds(path: Path, device_type: int, objects: Objects, *mappings: tuple[int, ...]) -> Path:
    """An EDS of these objects and of one TPDO by mapping."""
    every: dict[tuple[int, int], tuple[str, int, int | None]] = {
        (0x1000, 0): ("Device type", U32, device_type),
        (0x1001, 0): ("Error register", U8, 0),
        (0x1018, 0): ("Identity", U8, 1),
        (0x1018, 1): ("Vendor-ID", U32, 0x4D2),
        **objects,
    }
    for number, entries in enumerate(mappings):
        every[0x1800 + number, 0] = ("TPDO parameter", U8, 2)
        every[0x1800 + number, 1] = ("COB-ID", U32, None)
        every[0x1800 + number, 2] = ("Transmission type", U8, 0xFE)
        every[0x1A00 + number, 0] = ("TPDO mapping", U8, len(entries))
        for sub, entry in enumerate(entries, 1):
            every[0x1A00 + number, sub] = (f"Entry {sub}", U32, entry)
    lines = ["[FileInfo]", "FileName=own.eds", "[DeviceInfo]", "VendorName=Own", "ProductName=Own"]
    indexes = sorted({index for index, _ in every})
    mandatory = [index for index in indexes if index in (0x1000, 0x1001, 0x1018)]
    for title, listed in (
        ("MandatoryObjects", mandatory),
        ("OptionalObjects", [index for index in indexes if index not in mandatory]),
    ):
        lines += [f"[{title}]", f"SupportedObjects={len(listed)}"]
        lines += [f"{k}=0x{index:04X}" for k, index in enumerate(listed, 1)]
    for index in indexes:
        subs = sorted(sub for i, sub in every if i == index)
        if subs != [0]:
            name = every[index, 0][0]
            lines += [f"[{index:04X}]", f"ParameterName={name}", "ObjectType=0x9"]
            lines += [f"SubNumber={len(subs)}"]
        for sub in subs:
            name, kind, value = every[index, sub]
            text = f"$NODEID+0x{0x180 + 0x100 * (index - 0x1800):X}" if name == "COB-ID" else value
            lines += [f"[{index:04X}]" if subs == [0] else f"[{index:04X}sub{sub:X}]"]
            lines += [f"ParameterName={name}", "ObjectType=0x7", f"DataType=0x{kind:04X}"]
            lines += ["AccessType=rw", f"DefaultValue={'' if text is None else text}"]
            lines += ["PDOMapping=1"]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


INCLINOMETER: Objects = {
    (0x6000, 0): ("Resolution", U16, 10),
    (0x6010, 0): ("Slope long16", I16, None),
    (0x6011, 0): ("Slope long16 operating parameter", U8, 0),
    (0x6012, 0): ("Slope long16 preset value", I16, 0),
    (0x6020, 0): ("Slope lateral16", I16, None),
    (0x6110, 0): ("Slope long32", I32, None),
    (0x6120, 0): ("Slope lateral32", I32, None),
}


@pytest.fixture
def tilt(tmp_path: Path) -> Script:
    """A described inclinometer, OPERATIONAL."""
    path = eds(
        tmp_path / "tilt.eds",
        0x0002019A,
        INCLINOMETER,
        (0x60100010, 0x60200010),
        (0x61100020, 0x61200020),
    )
    return Script(path.as_posix(), 5).heartbeat(0, 4000)


def sway(k: int) -> tuple[int, int]:
    return -1000 + 10 * k, 500 - 5 * k


def test_an_inclinometer_by_its_eds_has_both_slopes_in_both_widths(tilt: Script) -> None:
    tilt.pdo(5, 4000, 50, sway, bits=16).pdo(7, 4000, 50, sway, base=0x280)
    told = tilt.read(10, 0x6000, 0, 100, size=2).told()
    assert sorted(told.traced()) == [0x6010, 0x6020, 0x6110, 0x6120]
    for index, axis, first, words in (
        (0x6010, 0, -100.0, "longitudinal"),
        (0x6020, 1, 50.0, "lateral"),
        (0x6110, 0, -100.0, "longitudinal"),
        (0x6120, 1, 50.0, "lateral"),
    ):
        trace, row = told.trace(index), told.trace_row(index)
        expected = [sway(k)[axis] * 0.1 for k in range(len(trace.value))]
        # The EDS says 10 until 6000h was read at 10 ms.
        assert trace.value[1:] == pytest.approx(expected[1:])
        assert trace.value[0] == pytest.approx(first / 10)
        assert says(row.shows, words, "0.1 deg per count")
        assert row.unit == "deg"
        assert row.cuts == 1
    assert told.accusations == []


@pytest.mark.triggers("angle.scale_assumed")
def test_the_resolution_of_the_eds_alone_is_said_to_be_assumed(tilt: Script) -> None:
    told = tilt.pdo(5, 4000, 50, sway, bits=16).told()
    assert told.trace(0x6010).value[0] == pytest.approx(-10.0)
    assert told.trace_row(0x6010).assumed == ["res"]
    assert says(told.finding("angle.scale_assumed").text, "resolution (6000h)", "assumed")


@pytest.mark.parametrize("index", [0x6012, 0x6011])
def test_a_preset_of_an_inclinometer_cuts_its_slopes(tilt: Script, index: int) -> None:
    tilt.read(10, 0x6000, 0, 10, size=2)
    tilt.pdo(15, 4000, 50, lambda k: (2000 if k < 40 else -2000, 0), bits=16)
    told = tilt.write(2005, index, 0, 1, size=2).told()
    assert says(told.events("cut", 0x6010)[-1].text, f"{index:04X}h written", "longitudinal slope")
    assert told.trace_row(0x6010).cuts == 1
    assert told.accusations == []


@pytest.mark.triggers("angle.out_of_range")
def test_an_impossible_slope_is_the_scales_fault(tilt: Script) -> None:
    told = tilt.pdo(15, 4000, 50, lambda k: (-23_700 + k, 0), bits=16).told()
    assert says(told.finding("angle.out_of_range").text, "-237", "the scale is assumed")


def test_one_axis_alone(tmp_path: Path) -> None:
    objects = {key: value for key, value in INCLINOMETER.items() if key[0] in (0x6000, 0x6010)}
    path = eds(tmp_path / "one.eds", 0x0001019A, objects, (0x60100010,))
    script = Script(path.as_posix(), 5).heartbeat(0, 4000).read(1, 0x6000, 0, 1000, size=2)
    told = script.pdo(5, 4000, 50, lambda k: k, bits=16).told()
    assert told.traced() == [0x6010]
    assert told.trace(0x6010).value[30] == 30.0


ENCODER: Objects = {
    (0x6000, 0): ("Operating parameters", U16, 0),
    (0x6001, 0): ("Measuring units per revolution", U32, None),
    (0x6002, 0): ("Total measuring range", U32, None),
    (0x6003, 0): ("Preset value", U32, None),
    (0x6004, 0): ("Position value", U32, None),
}
CHANNELS: Objects = {
    (0x6010, 0): ("Preset values for multi-sensor devices", U8, 2),
    (0x6010, 1): ("Preset value channel 1", I32, None),
    (0x6010, 2): ("Preset value channel 2", I32, None),
    (0x6020, 0): ("Position values for multi-sensor devices", U8, 2),
    (0x6020, 1): ("Position value channel 1", I32, None),
    (0x6020, 2): ("Position value channel 2", I32, None),
}


def channel(told: Told, sub: int) -> np.ndarray:
    return next(t for t in told.analysis.trace_data if t.object == 0x602000 | sub).value


def test_an_encoder_by_its_eds(tmp_path: Path) -> None:
    path = eds(tmp_path / "one.eds", 0x00020196, ENCODER, (0x60040020,))
    script = Script(path.as_posix(), 5).heartbeat(0, 4000)
    script.read(1, 0x6001, 0, 3600).read(3, 0x6002, 0, 3600 * 16).read(5, 0x6000, 0, 0, size=2)
    told = script.pdo(10, 4000, 50, lambda k: (100 * k - 500) % 57_600).told()
    trace = told.trace()
    assert trace.columns["angle_deg"][:7].tolist() == [310, 320, 330, 340, 350, 0, 10]
    assert trace.columns["turn"][4:6].tolist() == [15, 0]
    assert np.diff(trace.columns["unwrapped_deg"]) == pytest.approx(10.0)
    assert trace.assumed == []
    assert told.accusations == []


def test_two_channels_of_a_rotary_multi_sensor_encoder(tmp_path: Path) -> None:
    """CiA 406: 6020h:1 and 6020h:2 hold the positions, 6010h their presets."""
    objects = {**ENCODER, **CHANNELS}
    path = eds(tmp_path / "two.eds", 0x000A0196, objects, (0x60200120, 0x60200220))
    script = Script(path.as_posix(), 5).heartbeat(0, 4000)
    script.read(1, 0x6001, 0, 3600).read(3, 0x6002, 0, 3600 * 16)
    script.pdo(10, 4000, 50, lambda k: (100 * k, 40_000 - 100 * k + (9000 if k >= 40 else 0)))
    told = script.write(2008, 0x6010, 2, 9000, size=4).told()
    rows = {row.object: row for row in told.analysis.traces}
    assert sorted(rows) == [0x602001, 0x602002]
    one, two = (
        next(t for t in told.analysis.trace_data if t.object == number) for number in sorted(rows)
    )
    assert one.columns["angle_deg"][3] == 30.0
    assert np.diff(two.columns["unwrapped_deg"][:30]) == pytest.approx(-10.0)
    assert "Position value channel 2" in two.name
    cuts = [e for e in told.analysis.trace_events if e.kind == "cut"]
    assert {e.text for e in cuts} == {"preset of channel 2 (6010h written)"}
    assert told.accusations == []


@pytest.mark.near_miss("angle.out_of_range")
@pytest.mark.near_miss("angle.scale_assumed")
def test_a_linear_encoder_measures_mm(tmp_path: Path) -> None:
    """CiA 406: 1000h says absolute linear; 6005h:1 is the step in nm. Positions may be negative."""
    objects = {
        **CHANNELS,
        (0x6005, 0): ("Measuring step settings", U8, 1),
        (0x6005, 1): ("Position measuring step", U32, None),
    }
    path = eds(tmp_path / "way.eds", 0x000A0196, objects, (0x60200120, 0x60200220))
    script = Script(path.as_posix(), 5).heartbeat(0, 4000).read(1, 0x6005, 1, 5000)
    told = script.pdo(10, 4000, 50, lambda k: (200 * k - 1000, 7)).told()
    assert channel(told, 1)[:3] == pytest.approx([-5.0, -4.0, -3.0])
    assert {row.unit for row in told.analysis.traces} == {"mm"}
    assert told.ids == []
    blind = Script(path.as_posix(), 5).heartbeat(0, 4000)
    plain = blind.pdo(10, 4000, 50, lambda k: (200 * k - 1000, 7)).told()
    assert {row.unit for row in plain.analysis.traces} == {"counts"}
    assert plain.ids == []


def test_a_channel_of_an_unknown_encoder_is_traced_by_its_mapping(tmp_path: Path) -> None:
    """Without an EDS: 1000h names the profile, 1A00h was read."""
    script = Script(None, 5).heartbeat(0, 4000).read(1, 0x1000, 0, 0x000A0196)
    script.read(3, 0x1800, 1, 0x185).read(5, 0x1A00, 0, 1, size=1)
    script.read(7, 0x1A00, 1, 0x60200120).read(9, 0x6001, 0, 3600)
    told = script.pdo(20, 4000, 50, lambda k: 100 * k).told()
    (trace,) = told.analysis.trace_data
    assert trace.object == 0x602001
    assert trace.columns["angle_deg"][3] == 30.0


@pytest.mark.parametrize(
    ("index", "value", "size", "shown"),
    [(0x6112, -4500, 4, -4500), (0x6012, -450, 2, -450), (0x6114, 50, 4, 50)],
)
def test_settings_of_an_inclinometer_without_an_eds_have_their_sign(
    index: int, value: int, size: int, shown: int
) -> None:
    script = Script(None, 7).read(5, 0x1000, 0, 0x0002019A)
    told = script.write(100, index, 0, value, size=size).told()
    (change,) = (c for c in told.analysis.object_changes if c.index == index)
    assert change.new == shown
    assert change.words.endswith(f" longitudinal slope {shown}")
