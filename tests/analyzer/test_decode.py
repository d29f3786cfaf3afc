"""`syncline decode`: what it says of each frame, which frames it shows, and that nothing is cut."""

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer.decode import stream
from syncline_analyzer.decode.choice import Choice
from syncline_analyzer.decode.stream import Decoding
from syncline_analyzer.decode_command import decode
from syncline_analyzer.opened import Opened
from syncline_analyzer.readers.live import LiveReader, first_line
from syncline_analyzer.session import open_session
from syncline_analyzer.views.decode_lines import COLOURS, Columns, DecodedLines
from syncline_samples.forty_nodes import forty_nodes
from syncline_samples.generate import candump_log, mcap_capture
from syncline_samples.scenarios import healthy_line
from syncline_schemas.description import BusDescription

SAMPLES = Path(__file__).parents[2] / "samples"
BAD_DAY = SAMPLES / "bad_day.mcap"


def run(*words: object) -> Result:
    result = CliRunner().invoke(decode, [str(word) for word in words], standalone_mode=False)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def lines(*words: object) -> list[str]:
    return run(*words).stdout.splitlines()


def said(line: str) -> str:
    """What a line says, behind the columns of fixed width."""
    return line[len("       0     0:00.000000 701h     heartbeat 1 entry roller   00") + 22 :]


def log(tmp_path: Path, *frames: str) -> Path:
    """A candump log with a frame each 10 ms."""
    path = tmp_path / "a.log"
    path.write_text(
        "".join(f"({n * 10 / 1000:.6f}) can0 {text}\n" for n, text in enumerate(frames))
    )
    return path


def words_of(tmp_path: Path, *frames: str, device: str = "") -> list[str]:
    options = ("--device", device) if device else ()
    return [said(line) for line in lines(log(tmp_path, *frames), *options)]


@pytest.fixture(scope="module")
def forty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("forty") / "forty.mcap"
    path.write_bytes(mcap_capture(forty_nodes(5.0).run()))
    return path


def test_a_line_has_time_identifier_service_node_bytes_and_meaning() -> None:
    assert lines(BAD_DAY, "--frames", "1224") == [
        (
            "    1224     0:12.800119 082h     EMCY      2 guide roller   10 60 01 00 00 04 00 00"
            " 6010h reset by the watchdog, register 01h general, warnings watchdog reset"
        )
    ]
    assert lines(BAD_DAY, "--frames", "1224", "--utc")[0][9:35] == "2026-03-02 06:00:13.100236"


def test_every_emcy_and_command_of_the_bad_day_is_told() -> None:
    expected = json.loads((SAMPLES / "bad_day.expected.json").read_text(encoding="utf-8"))
    told = lines(BAD_DAY, "--service", "emcy,nmt")
    emcys = [line for line in told if " EMCY " in line]
    assert len(emcys) == sum(node["emcy"] for node in expected["nodes"])
    assert [line for line in told if "reset communication: all nodes" in line]
    errors = lines(BAD_DAY, "--service", "error")
    assert len(errors) == expected["capture"]["error_frames"] + 1
    assert "nothing heard on can0 for 1.5 s: adapter lost, 148 frames lost" in errors[0]
    assert len(lines(BAD_DAY)) == expected["capture"]["frames"] + 1


def test_network_management_in_words(tmp_path: Path) -> None:
    assert words_of(
        tmp_path, "000#0100", "000#8205", "000#0305", "000#01", "70A#00", "70A#7F", "70A#05",
        "70A#04", "70A#33", "70B#R1", "70B#85", "70B#00",
    ) == [
        "start: all nodes",
        "reset communication: node 5",
        "unknown 03h: node 5",
        "NMT command with 1 instead of 2 bytes",
        "boot-up",
        "PRE-OPERATIONAL",
        "OPERATIONAL",
        "STOPPED",
        "unknown state 33h",
        "guard request",
        "OPERATIONAL, toggle 1",
        "boot-up",
    ]  # fmt: skip


def test_other_services_in_words(tmp_path: Path) -> None:
    day = (14 * 365 + 4).to_bytes(2, "little").hex()
    assert words_of(
        tmp_path, "080#", "080#07", f"100#80EE3600{day}", "7E5#1105000000000000",
        "7E4#1101000000000000", "085#3081110000000000", "085#0000000000000000", "085#3081",
        "123#AABB", "18FEF728#0102",
    ) == [
        "SYNC",
        "SYNC 7",
        "1998-01-01 01:00:00.000",
        "configure node-ID: 5",
        "configure node-ID: refused, node-ID out of range",
        "8130h life guard or heartbeat error, register 11h generic, communication",
        "0000h error reset or no error, register 00h",
        "EMCY with 2 instead of 8 bytes: only the code 8130h (life guard or heartbeat error)",
        "-",
        "not of CANopen",
    ]  # fmt: skip


def test_expedited_transfers_name_the_object_its_value_and_the_reason_of_an_abort(
    tmp_path: Path,
) -> None:
    assert words_of(
        tmp_path, "605#2B171000F4010000", "585#6017100000000000", "605#4018100200000000",
        "585#8018100211000906", "605#2310100173617665", "585#4B00200134120000",
    ) == [
        "write 1017h:00 producer heartbeat time = 500 ms",
        "1017h:00 producer heartbeat time written",
        "read 1018h:02 identity: product code",
        "abort 1018h:02 identity: product code: 06090011h subindex does not exist",
        'write 1010h:01 store parameters: all = "save"',
        "2000h:01 = 4660 (1234h)",
    ]  # fmt: skip


def test_segments_say_what_they_are_of_and_the_last_one_the_value(tmp_path: Path) -> None:
    assert words_of(
        tmp_path, "605#4008100000000000", "585#410810000A000000", "605#6000000000000000",
        "585#0053796E636C696E", "605#7000000000000000", "585#1965203100000000",
    )[1:] == [
        "1008h:00 manufacturer device name: 10 bytes in segments",
        "next segment of 1008h:00 manufacturer device name",
        "segment of 1008h:00 manufacturer device name, 7 bytes",
        "next segment of 1008h:00 manufacturer device name",
        'last segment of 1008h:00 manufacturer device name = "Syncline 1"',
    ]  # fmt: skip


def test_blocks_are_followed_though_their_segments_look_like_anything(tmp_path: Path) -> None:
    """CiA 301 7.2.4.3.9: the second segment's first byte is that of an answer to a write (60h)."""
    first = "605#0141424344454647"
    told = words_of(
        tmp_path, "605#C60820000A000000", "585#A408200004000000", first, "605#8248494A00000000",
        "585#A202040000000000", "605#D1AABB0000000000", "585#A100000000000000",
        "605#4018100100000000",
    )  # fmt: skip
    assert told == [
        "write 2008h:00 in blocks, 10 bytes",
        "blocks accepted of 2008h:00, 4 segments a block",
        "block segment 1 of 2008h:00",
        "last block segment 2 of 2008h:00",
        "block taken of 2008h:00 up to segment 2, next 4",
        "end of blocks of 2008h:00 = 41 42 43 44 45 46 47 48 49 4a, CRC BBAAh",
        "block transfer of 2008h:00 done",
        "read 1018h:01 identity: vendor-ID",
    ]


def test_pdos_are_told_by_the_mapping_that_holds_at_their_frame(tmp_path: Path) -> None:
    """TPDO1 of a device that nobody knows carries 6010h and 6020h at first, then 6020h alone."""

    def write(sub: int, value: int) -> tuple[str, str]:
        bytes_ = value.to_bytes(4, "little").hex()
        return f"60B#23001A{sub:02X}{bytes_}", f"58B#60001A{sub:02X}00000000"

    first = (*write(0, 0), *write(1, 0x60100010), *write(2, 0x60200010), *write(0, 2))
    then = (*write(0, 0), *write(1, 0x60200010), *write(0, 1))
    told = words_of(tmp_path, "18B#0700", *first, "18B#0700FFFF", *then, "18B#0600")
    assert told[0] == "mapping not known"
    assert told[1 + len(first)] == "6010h:00 7, 6020h:00 65535"
    assert told[-1] == "6020h:00 6"


def test_a_value_whose_scale_is_only_assumed_is_marked(tmp_path: Path) -> None:
    told = words_of(tmp_path, "18A#7B00F6FF", "18A#7B00", device="10=jn2100")
    assert told[0] == "Slope longitudinal 16 ~12.3 deg, Slope lateral 16 ~-1.0 deg"
    assert told[1] == "Slope longitudinal 16 ~12.3 deg, shorter than its mapping"


def test_a_pdo_of_which_only_the_identifier_is_known_is_a_guess(tmp_path: Path) -> None:
    (line,) = lines(log(tmp_path, "18A#0102"))
    assert "TPDO1?" in line
    assert said(line) == "mapping not known"


def test_the_last_digit_is_that_of_the_scale(tmp_path: Path) -> None:
    frames = ("60A#4000600000000000", "58A#4B0060000A000000", "18A#D2040000")
    assert words_of(tmp_path, *frames, device="10=jn2100")[-1].startswith(
        "Slope longitudinal 16 12.34 deg"
    )


def test_what_is_chosen_by_node_service_identifier_place_and_time() -> None:
    every = lines(BAD_DAY)
    node = lines(BAD_DAY, "--node", "10", "--service", "sdo")
    assert node
    assert {line[25:31].strip() for line in node if line[0] == " "} == {"60Ah", "58Ah"}
    assert all(line in every for line in node)
    ranged = lines(BAD_DAY, "--cob-id", "700-77F", "--from", "10s", "--to", "11s", "-n", "3")
    assert len(ranged) == 3
    assert all(" 0:10." in line for line in ranged)
    assert {line[25:28] for line in ranged} <= {f"7{n:02X}" for n in range(128)}
    commanded = lines(BAD_DAY, "--node", "10", "--service", "nmt")
    assert [line for line in commanded if "all nodes" in line]
    assert not [line for line in commanded if "node 3" in line and "30" not in line]


def test_a_part_is_told_by_what_was_seen_before_it() -> None:
    """The mapping was read long before: a line says the same, whatever is chosen."""
    every = {line[:9]: line for line in lines(BAD_DAY)}
    for line in lines(BAD_DAY, "--from", "60s", "--to", "70s"):
        assert line.startswith("---") or line == every[line[:9]]


@pytest.mark.parametrize(
    "words",
    [
        ["--node", "0"],
        ["--node", "x"],
        ["--service", "foo"],
        ["--cob-id", "XY"],
        ["--frames", "9-1"],
    ],
)
def test_a_wrong_choice_is_the_users_mistake(words: list[str]) -> None:
    with pytest.raises(Exception, match=words[1]):
        run(BAD_DAY, *words)


def test_json_lines_hold_the_same(tmp_path: Path) -> None:
    text, objects = (
        lines(BAD_DAY),
        [json.loads(line) for line in lines(BAD_DAY, "--format", "jsonl")],
    )
    assert len(text) == len(objects)
    for line, told in zip(text, objects, strict=True):
        if "gap" in told:
            assert told["gap"] in line
        else:
            assert int(line[:8]) == told["seq"]
            assert said(line) in (told["text"], "-")
    first = json.loads(lines(log(tmp_path, "18A#R4"), "--format", "jsonl")[0])
    assert (first["cob_id"], first["flags"], first["data"]) == (0x18A, ["remote"], "")


def test_a_log_without_times_has_no_times(tmp_path: Path) -> None:
    path = tmp_path / "bare.txt"
    path.write_text("can0  70A   [1]  05\ncan0  70A   [1]  7F\n")
    assert lines(path) == [
        "       0 70Ah     heartbeat 10               05                      OPERATIONAL",
        "       1 70Ah     heartbeat 10               7f                      PRE-OPERATIONAL",
    ]
    assert json.loads(lines(path, "--format", "jsonl")[0])["t_ns"] is None


def test_standard_input_is_a_capture_like_any_other(tmp_path: Path) -> None:
    given = log(tmp_path, "70A#05", "080#").read_bytes()
    result = CliRunner().invoke(decode, ["-"], input=given)
    assert result.exit_code == 0, result.output
    assert [said(line) for line in result.stdout.splitlines()] == ["OPERATIONAL", "SYNC"]


def test_nothing_on_standard_input_is_said_so() -> None:
    result = CliRunner().invoke(decode, ["-"], input=b"")
    assert "nothing came on standard input" in str(result.exception)


def test_two_buses_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "two.log"
    path.write_text("(0.000000) can0 70A#05\n(0.010000) can1 70A#05\n")
    assert [line[25:31] for line in lines(path)] == ["can0  ", "can1  "]


@pytest.mark.parametrize("width", [40, 60, 80, 100, 130])
def test_a_terminal_shows_every_word_within_its_width(width: int, forty: Path) -> None:
    for path in (BAD_DAY, SAMPLES / "jittery_sync.log", forty):
        opened = open_session(path).opened()
        decoding = Decoding(opened, Choice(seqs=(0, 1500)))
        narrow = DecodedLines(decoding, Columns(width), opened.first_ns or 0, headed=True)
        shown = [text for item in decoding.items() for text in narrow.lines(item)]
        assert max(len(row) for text in shown for row in text.split("\n")) <= width
        wide = [said(line) for line in lines(path, "--frames", "0-1500")]
        for line, text in zip(shown[1:], wide, strict=True):
            assert text == "-" or _letters(text) in _letters(line)


def _letters(text: str) -> str:
    return re.sub(r"\s+", "", text)


def test_colours_only_go_around_lines() -> None:
    decoding = Decoding(open_session(BAD_DAY).opened(), Choice())
    plain = DecodedLines(decoding, Columns(), 0)
    loud = DecodedLines(decoding, Columns(colours=COLOURS), 0)
    item = next(decoding.items())
    for line, coloured in zip(plain.lines(item), loud.lines(item), strict=True):
        assert re.sub(r"\x1b\[[0-9;]*m", "", coloured) == line
    assert any("\x1b[1;31m" in line and "EMCY" in line for line in loud.lines(item))


@settings(deadline=None, max_examples=5)
@given(frames=st.integers(1, 400))
def test_lines_do_not_depend_on_how_frames_are_cut_into_batches(frames: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stream, "FRAMES", frames)
        assert lines(BAD_DAY, "--frames", "40-900") == _whole()


@cache
def _whole() -> list[str]:
    return lines(BAD_DAY, "--frames", "40-900")


def test_a_dropped_payload_is_said_to_be_dropped(tmp_path: Path) -> None:
    from syncline_analyzer.redaction import Redaction

    opened = open_session(log(tmp_path, "18A#0000", "70A#00", "70B#00")).opened()
    redacted = replace(opened, redaction=Redaction.parse(["18A", "node:10"]).resolved({}))
    decoding = Decoding(redacted, Choice())
    writer = DecodedLines(decoding, Columns(), 0)
    told = [said(line) for item in decoding.items() for line in writer.lines(item)]
    assert told == ["payload dropped (redacted)"] * 2 + ["boot-up"]


def test_names_cannot_command_the_terminal(tmp_path: Path) -> None:
    description = tmp_path / "bus.toml"
    description.write_text('[bus.can0.node.10]\nname = "\\u001b[2Jboom"\n', encoding="utf-8")
    (line,) = lines(log(tmp_path, "70A#05"), "--description", description)
    assert "\x1b" not in line
    assert "boom" in line


def _process(*words: str, encoding: str = "utf-8") -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "syncline_logger", "decode", *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"},
    )


def test_a_reader_that_goes_away_is_no_error(tmp_path: Path) -> None:
    path = tmp_path / "long.log"
    path.write_bytes(candump_log(healthy_line(20.0).run()) * 8)
    with _process(str(path)) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert b"heartbeat" in process.stdout.readline()
        process.stdout.close()
        assert process.stderr.read() == b""


@pytest.mark.parametrize("encoding", ["cp1252", "cp437", "ascii"])
def test_a_code_page_without_a_character_shows_something_else(
    tmp_path: Path, encoding: str
) -> None:
    description = tmp_path / "bus.toml"
    description.write_text('[bus.can0.node.10]\nname = "Ωmega"\n', encoding="utf-8")
    path = log(tmp_path, "70A#05")
    with _process(str(path), "--description", str(description), encoding=encoding) as process:
        out, err = process.communicate()
    assert (process.returncode, err) == (0, b"")
    assert b"mega" in out


def _line(process: "subprocess.Popen[bytes]", *frames: str) -> bytes:
    """The line that a command prints for the last of the frames that it is given."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write("".join(f"{frame}\n" for frame in frames).encode())
    process.stdin.flush()
    return [process.stdout.readline() for _ in frames][-1].rstrip()


def test_what_candump_prints_is_decoded_line_by_line_while_it_comes() -> None:
    with _process("-", "--device", "10=jn2100") as process:
        told = _line(process, "(1700000000.000000) vcan0 18A#BE0D3C00")
        assert told.endswith(
            b"TPDO1     10 jn2100        be 0d 3c 00             "
            b"Slope longitudinal 16 ~351.8 deg, Slope lateral 16 ~6.0 deg"
        )
        told = _line(process, "(1700000000.500000) vcan0 08A#3081110000000000")
        assert told.startswith(b"       1     0:00.500000 08Ah     EMCY")
        told = _line(process, "(1700000001.000000) vcan1 70A#7F", "  vcan0  70A   [1]  05")
        assert b"vcan0" in told
        assert told.endswith(b"OPERATIONAL")
        rest, _ = process.communicate(b"(1700000002.000000) vcan1 000#8200")
        assert rest.rstrip().endswith(b"reset communication: all nodes")
        assert process.returncode == 0


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT to send")
def test_interrupted_live_decoding_ends_without_a_word() -> None:
    # Where the tests run in the background, SIGINT is ignored and would stay so.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        process = _process("-")
    finally:
        signal.signal(signal.SIGINT, before)
    with process:
        assert _line(process, "  vcan0  000   [2]  01 00").endswith(b"start: all nodes")
        process.send_signal(signal.SIGINT)
        rest, complaint = process.communicate()
        assert (rest, complaint.strip()) == (b"", b"")
        assert process.returncode == 130


def test_a_log_is_followed_while_it_grows(tmp_path: Path) -> None:
    path = tmp_path / "grows.log"
    path.write_text("(1.000000) can0 701#05\n(2.000000) can0 70", encoding="utf-8")
    with _process(str(path), "--follow", "-n", "3", "--format", "jsonl") as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["text"] == "OPERATIONAL"
        with path.open("a", encoding="utf-8") as log:
            log.write("2#04\n(3.000000) can0 703#7F\n(4.0")
        told = [json.loads(process.stdout.readline())["text"] for _ in range(2)]
        assert told == ["STOPPED", "PRE-OPERATIONAL"]
        process.communicate()
        assert process.returncode == 0


def test_only_a_growing_candump_log_can_be_followed(tmp_path: Path) -> None:
    for words, said_ in (
        ((BAD_DAY,), "only candump logs can be followed"),
        (("-",), "give one candump log"),
        ((tmp_path / "no.log",), "cannot be opened"),
    ):
        result = CliRunner().invoke(decode, [*map(str, words), "-f"], standalone_mode=False)
        assert said_ in str(result.exception)


def told(opened: Opened) -> list[str]:
    decoding = Decoding(opened, Choice())
    shown = DecodedLines(decoding, Columns(), opened.first_ns or 0)
    return [line for item in decoding.items() for line in shown.lines(item)]


@pytest.mark.parametrize("cut", [7, 100, 4000])
def test_text_that_comes_in_pieces_is_what_a_file_holds(cut: int, tmp_path: Path) -> None:
    text = candump_log(healthy_line(3.0).run())
    description = BusDescription.loads(healthy_line(3.0).start().description_toml)
    path = tmp_path / "a.log"
    path.write_bytes(text)
    pieces = iter([text[at : at + cut] for at in range(0, len(text), cut)])

    def read() -> bytes:
        return next(pieces, b"")

    session = open_session(path, description=description)
    live = session.opened_live(LiveReader(path, first_line(read), read))
    assert told(live) == told(session.opened())
