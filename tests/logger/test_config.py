"""logger.toml: all settings, all mistakes at once."""

import sys
import tomllib
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from syncline_logger.bus_options import BusOptions
from syncline_logger.cli import cli
from syncline_logger.config import (
    BUS_KEYS,
    NOT_IN_A_FILE,
    LoadedConfig,
    configured_buses,
    load_config,
    long_name,
)
from syncline_logger.record_command import record
from tests.logger.capture_contents import syncline

EXAMPLE = Path(__file__).parents[2] / "deploy" / "logger.toml"


def load(folder: Path, text: str) -> LoadedConfig:
    path = folder / "logger.toml"
    path.write_text(text, encoding="utf-8")
    return load_config(path, record.params)


def check(folder: Path, text: str, *words: str) -> tuple[int, list[str]]:
    """Exit code and lines of `record --check-config`."""
    import subprocess

    path = folder / "logger.toml"
    path.write_text(text, encoding="utf-8")
    done = subprocess.run(
        syncline("record", "--config", str(path), "--check-config", *words),
        capture_output=True,
        check=False,
        encoding="utf-8",
    )
    return done.returncode, (done.stdout + done.stderr).splitlines()


SLCAN_BUS = '[[bus]]\ninterface = "slcan"\nchannel = "/dev/ttyACM9"\n'
ONE_BUS = '[[bus]]\ninterface = "virtual"\nchannel = "a"\n'


def test_every_option_of_record_can_stand_in_the_file() -> None:
    options = {long_name(each) for each in record.params if isinstance(each, click.Option)}
    example = EXAMPLE.read_text(encoding="utf-8")
    told = {line.lstrip("# ").split(" = ")[0] for line in example.splitlines() if " = " in line}
    not_settings = {"config", "check_config", "bus"}
    assert options - not_settings - told == set()


def test_the_example_is_right_also_with_all_its_comments_taken_away(tmp_path: Path) -> None:
    (tmp_path / "bus.toml").write_text("[node.5]\nname = 'x'\n", encoding="utf-8")
    for uncommented in (False, True):
        lines = EXAMPLE.read_text(encoding="utf-8").splitlines()
        if uncommented:
            lines = [line[1:] if line.startswith("#") and " = " in line else line for line in lines]
        text = "\n".join(lines)
        tomllib.loads(text)
        assert load(tmp_path, text).problems == ()


def test_what_the_file_says_is_what_the_command_line_would(tmp_path: Path) -> None:
    config = load(
        tmp_path,
        'output = "out"\nflush = "500ms"\nlog_size = "2MB"\ndecode = false\nfor = "8h"\n'
        'device = ["5=jn2100", "6=own.eds"]\nbus_kwargs = { serial = 12, x = true }\n' + ONE_BUS,
    )
    assert config.problems == ()
    assert config.values == {
        "output": str(tmp_path / "out"),
        "flush_ns": "500ms",
        "log_size": "2MB",
        "decode": False,
        "duration_ns": "8h",
        "devices": ["5=jn2100", f"6={tmp_path / 'own.eds'}"],
        "bus_kwargs": ["serial=12", "x=true"],
    }


def test_a_bus_has_what_its_table_says_else_what_holds_for_all(tmp_path: Path) -> None:
    config = load(
        tmp_path,
        '[[bus]]\nname = "press"\ninterface = "pcan"\nchannel = "PCAN_USBBUS1"\nbitrate = 250000\n'
        'filter = ["180:780"]\nbus_kwargs = { a = 1 }\ntiming = { brp = 2 }\n'
        '[[bus]]\nchannel = 0\nfd = true\ninterface = "kvaser"\n',
    )
    common = BusOptions("", bitrate=500_000, arguments={"b": 2}, acknowledge=True)
    press, other = configured_buses(config, common, {})
    assert press == BusOptions(
        "press",
        "pcan",
        "PCAN_USBBUS1",
        250_000,
        timing={"brp": 2},
        filters=({"can_id": 0x180, "can_mask": 0x780},),
        arguments={"a": 1, "b": 2},
        acknowledge=True,
    )
    assert other == BusOptions(
        "0", "kvaser", 0, 500_000, fd=True, arguments={"b": 2}, acknowledge=True
    )


def test_the_command_line_goes_before_the_file(tmp_path: Path) -> None:
    config = load(tmp_path, ONE_BUS + "bitrate = 250000\n")
    (bus,) = configured_buses(config, BusOptions("", bitrate=125_000), {"bitrate": 125_000})
    assert bus.bitrate == 125_000
    code, lines = check(tmp_path, ONE_BUS + "bitrate = 250000\n", "-b", "125000", "-o", "here")
    assert code == 0
    assert lines == ["fine; to here will be recorded:", "  a: virtual a, 125000 bit/s"]


def test_buses_of_the_command_line_replace_those_of_the_file(tmp_path: Path) -> None:
    code, lines = check(tmp_path, "bitrate = 1000000\n" + ONE_BUS, "--bus", "x=virtual:b")
    assert code == 0
    assert lines[1:] == ["  x: virtual b, 1000000 bit/s"]


WRONG = """
outptu = "out"
flush = "soon"
status-period = "1s"
status_file = 5
decode = "yes"
log_keep = 0
log_size = "big"
device = "5=jn2100"
description = "missing.toml"
prometheus = "x.json"
[[bus]]
name = "press"
interface = "virtul"
channel = "a"
bitrate = "500k"
output = "x"
fdd = true
[[bus]]
name = "press"
channel = 1.5
bitrate = -1
data_bitrate = 2000000
timing = { brp = "x" }
filter = ["zz"]
"""
SAID = [
    "outptu: is no key; write output",
    "flush: 'soon' is no time; write 500ms",
    "status-period: is no key; write status_period",
    "status_file: 5 is not a text in quotes; write status_file =",
    'decode: "yes" is not true or false; write decode = true',
    "log_keep: 0 is not more than 0",
    "log_size: 'big' is no size; write 256MB",
    'device: "5=jn2100" is not a list of texts; write device = ["5=jn2100"]',
    "description: File",
    'bus 1 (press): bitrate: "500k" is not a whole number; write bitrate = 500000',
    "bus 1 (press): output: is no key of a bus; write it above the first [[bus]]",
    "bus 1 (press): fdd: is no key; write fd",
    "bus 2 (press): channel: 1.5 is not a text in quotes or a whole number",
    "bus 2 (press): bitrate: -1 is not more than 0",
    'bus 2 (press): timing: { brp = "x" } is not a table { key = number }',
    "bus 2 (press): filter: ",
    'bus 2 (press): has no interface; write interface = "socketcan"',
]


def test_all_mistakes_are_told_at_once_with_file_key_and_what_to_write(tmp_path: Path) -> None:
    problems = load(tmp_path, WRONG).problems
    assert len(problems) == len(SAID)
    for problem, said in zip(problems, SAID, strict=True):
        assert problem.startswith(f"{tmp_path / 'logger.toml'}: {said}")


def test_mistakes_that_need_the_whole_are_among_them(tmp_path: Path) -> None:
    code, lines = check(tmp_path, WRONG)
    assert code == 2
    assert len(lines) == len(SAID) + 4
    for text in (
        "there is no interface 'virtul'",
        "2 buses are called 'press'",
        "does not end in .prom",
        "a data bit rate is for CAN FD alone",
    ):
        assert any(text in line for line in lines), text


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x = ", "is no TOML"),
        ('bus = "can0"', "bus: write each bus as a table that begins with [[bus]]"),
        ("[bus]\nx = 1", "bus: write each bus as a table that begins with [[bus]]"),
        ("bitrate = true", "bitrate: true is not a whole number"),
        (
            "nothing_like_it = 1",
            "nothing_like_it: is no key; there are acknowledge, after, before,",
        ),
        ('config = "x.toml"', "config: is no key"),
        ('channel = ["x"]\n[[bus]]\ninterface = "virtual"', "write one in each [[bus]]"),
    ],
)
def test_a_mistake(tmp_path: Path, text: str, said: str) -> None:
    (problem,) = load(tmp_path, text).problems
    assert said in problem


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (ONE_BUS + ONE_BUS.replace("[[bus]]", '[[bus]]\nname = "b"'), "are both virtual a"),
        (ONE_BUS + "bitrate = 0\n", "bus 1: bitrate: 0 is not more than 0"),
        ('log = "x.prom"\nprometheus = "x.prom"\n' + ONE_BUS, "are the same file"),
        ('device = ["500=x"]\n' + ONE_BUS, "is not NODE=NAME_OR_EDS"),
        ('output = "x"\n', "no bus is given"),
        ('flush = "1h"\n' + ONE_BUS, "flush: more than 1m: all of it is lost when the power goes"),
        (
            SLCAN_BUS + "bitrate = 123456\n",
            "bus 1: bitrate: slcan adapters know no bit rate of 123456 bit/s; they know 10000,",
        ),
        (
            SLCAN_BUS + "bitrate = 500000\nfd = true\ndata_bitrate = 3000000\n",
            "bus 1: data_bitrate: slcan adapters know no data bit rate of 3000000 bit/s",
        ),
        (SLCAN_BUS + "bitrate = 500\n", "bus 1: bitrate: 500 is no bit rate in bit/s"),
        ('output = "x"\nbus = [1, 2]\n', "bus: write each bus as a table"),
    ],
)
def test_a_contradiction(tmp_path: Path, text: str, said: str) -> None:
    code, lines = check(tmp_path, text)
    assert (code, len(lines)) == (2, 1)
    assert said in lines[0]


def test_no_bytes_raise(tmp_path: Path) -> None:
    path = tmp_path / "logger.toml"
    path.write_bytes(b"\xff\xfe\x00")
    (problem,) = load_config(path, record.params).problems
    assert problem == f"{path} cannot be read: it is no UTF-8 text"
    (problem,) = load_config(tmp_path, record.params).problems
    assert "cannot be read" in problem


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    done = CliRunner().invoke(cli, ["record", "--config", str(tmp_path / "none.toml")])
    assert done.exit_code == 2
    assert "does not exist" in done.output


def test_every_key_of_a_bus_is_an_option_too() -> None:
    options = {long_name(each) for each in record.params if isinstance(each, click.Option)}
    assert set(BUS_KEYS) - {"name"} <= options
    assert {each.name for each in record.params} >= NOT_IN_A_FILE - {"help"}


@pytest.mark.parametrize("content", [b'output = "o\n', b"\xff\xfe"])
def test_a_file_that_cannot_be_read_is_one_mistake(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "logger.toml"
    path.write_bytes(content)
    result = CliRunner().invoke(record, ["--config", str(path), "--check-config"])
    assert "no bus" not in f"{result.output}{result.exception}"
    assert str(path) in str(result.exception)


NASTY = """
output = "/proc/nope"
log = "a-file/x.log"
split_time = "1x"
keep = "8 potatoes"
flush = "1ms"
ring_size = "1"
trigger = ["emcy:200", "nmt:7:dancing", "gap:nobus", "emcy"]
device = ["5=nothing", "x", "6=jn2100", "nobus:7=jn2100"]
filter = ["zz:1", "180:780", "qq"]
bitrate = 500
[[bus]]
name = "a b/c"
interface = "socketcan"
chanel = "can0"
[[bus]]
name = "x"
interfac = "socketcan"
bitrate = 500000
timing = { f_clock = 8000000, brp = 1 }
[[bus]]
name = "x"
interface = "nosuch"
channel = "can1"
data_bitrate = 2000000
timing = { f_clock = 8000000, brp = 1, tseg1 = 999, tseg2 = 2, sjw = 1 }
"""
NASTY_SAID = """
split_time: '1x' is no time; write 500ms, 10s, 5m, 2h or 1d
keep: "8 potatoes" is not a list of texts; write keep = ["8 potatoes"]
keep: '8 potatoes' is no size and no time; write 20GB or 14d
filter: 'zz:1' is not ID:MASK or ID~MASK (hexadecimal)
filter: 'qq' is not ID:MASK or ID~MASK (hexadecimal)
bus 1 (a b/c): chanel: is no key; write channel
bus 1 (a b/c): has no channel; write channel = "can0"
bus 1 (a b/c): name: 'a b/c' is no name; write letters, digits and _ . - only
bus 2 (x): interfac: is no key; write interface
bus 2 (x): has no interface; write interface = "socketcan"
bus 2 (x): has no channel; write channel = "can0"
device: no device is called 'nothing'
device: 'x' is not NODE=NAME_OR_EDS
device: 'nobus:7=jn2100': there is no bus 'nobus', only
bitrate: 500 is no bit rate in bit/s; write 500000
bus 2 (x): timing: tseg1, tseg2, sjw missing; write all of f_clock, brp, tseg1, tseg2, sjw
bus 3 (x): interface: there is no interface 'nosuch'
bus 3 (x): data_bitrate: bus 'x': a data bit rate is for CAN FD alone
bus 3 (x): timing: tseg1 (=999) must be in [1...16]; see the data sheet
bus 2 (x): name: 2 buses are called 'x'; give each [[bus]] a name of its own
trigger: 'emcy:200': '200' is no node; write 1 to 127, * for all, or BUS/NODE
trigger: 'nmt:7:dancing': 'dancing' is no NMT state; write
trigger: 'gap:nobus': there is no bus 'nobus', only
ring_size: 1 byte: at least 1000000 are needed; write a unit, like 100MB
flush: less than 10ms wears out the disk for nothing; write 1s
output: nothing can be written in /proc: No such file or directory; name a folder
log: a-file is no folder; name a folder that can be written
"""


@pytest.mark.skipif(sys.platform != "linux", reason="has a folder that nobody can write in")
def test_a_nasty_file(tmp_path: Path) -> None:
    """Twenty-seven mistakes, told in one go: each with the file, its key and what to write."""
    (tmp_path / "a-file").touch()
    code, lines = check(tmp_path, NASTY)
    path = tmp_path / "logger.toml"
    head = f"syncline: {path}: "
    told = [line.removeprefix(head).replace(f"{tmp_path}/", "") for line in lines]
    assert code == 2
    assert [line for line in lines if not line.startswith(head)] == []
    said = NASTY_SAID.strip().splitlines()
    assert [line for line in said if not any(each.startswith(line) for each in told)] == []
    assert [line for line in told if not any(line.startswith(each) for each in said)] == []


def test_what_is_not_there_yet_can_be_made(tmp_path: Path) -> None:
    text = 'output = "a/b"\nlog = "c/d.log"\nstatus_file = "e/s.json"\n' + ONE_BUS
    code, lines = check(tmp_path, text)
    assert (code, lines[0]) == (0, f"fine; to {tmp_path / 'a/b'} will be recorded:")
    assert [each.name for each in tmp_path.iterdir()] == ["logger.toml"], "nothing is left"


def test_a_capture_that_exists_is_told_before_the_start(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").touch()
    code, lines = check(tmp_path, 'output = "x.mcap"\n' + ONE_BUS)
    assert code == 2
    assert "output: " in lines[0]
    assert "recordings never overwrite a file" in lines[0]


def test_mistakes_of_the_command_line_name_the_option(tmp_path: Path) -> None:
    code, lines = check(tmp_path, ONE_BUS, "--trigger", "x", "--ring-size", "1", "--device", "y")
    assert code == 2
    heads = [line.removeprefix("syncline: ").split(":")[0] for line in lines]
    assert heads == ["--device", "--trigger", "--ring-size"]
