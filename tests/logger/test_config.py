"""logger.toml: all settings, all mistakes at once."""

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
    'device: "5=jn2100" is not a list of texts; write device = ["..."]',
    "description: File",
    'bus 1 (press): bitrate: "500k" is not a whole number; write bitrate = 500000',
    "bus 1 (press): output: is no key of a bus; write it above the first [[bus]]",
    "bus 1 (press): fdd: is no key; write fd",
    "bus 2 (press): channel: 1.5 is not a text in quotes or a whole number",
    "bus 2 (press): bitrate: -1 is not more than 0",
    "bus 2 (press): timing: {'brp': 'x'} is not a table { key = number }",
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
        ("bitrate = true", "bitrate: True is not a whole number"),
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
    ],
)
def test_a_contradiction(tmp_path: Path, text: str, said: str) -> None:
    code, lines = check(tmp_path, text)
    assert code == 2
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
