"""The process that `syncline` starts before it knows what it will read, and how it may end."""

import json
import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from textwrap import dedent
from typing import NamedTuple

import pytest

from syncline_schemas import second_process
from tests.analyzer.test_reading_process import traffic, write

READER = "syncline_analyzer.reading_process"
ONE_BYTE, NONE_IS_LARGE = 1, 1 << 60


class Ended(NamedTuple):
    """How a command ended, and the exit codes of the processes that it started."""

    code: int
    out: str
    err: str
    started: list[int | None]

    @property
    def told(self) -> tuple[int, str, str]:
        return self.code, self.out, self.err


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    return write(tmp_path / "small.mcap", traffic(500))


def program(folder: Path, least_bytes: int, more: str) -> list[str]:
    """`syncline` that takes files of so many bytes for large, and notes what it starts."""
    code = f"""
        import atexit, json, sys
        from pathlib import Path
        from syncline_schemas import second_process as second

        def note():
            codes = [each.returncode for each in started]
            Path({str(folder / "started.json")!r}).write_text(json.dumps(codes), encoding="utf-8")

        def noted(module):
            started.append(start(module))
            return started[-1]

        atexit.register(note)
        started, start, begin = [], second._started, second.begin
        second.LEAST_BYTES, second.processors, second._started = {least_bytes}, lambda: 2, noted
        """
    end = "from syncline_logger.start import main\nmain()"
    return [sys.executable, "-c", f"{dedent(code)}\n{dedent(more)}\n{end}"]


def run(folder: Path, *words: str, least_bytes: int = ONE_BYTE, more: str = "") -> Ended:
    done = subprocess.run(
        [*program(folder, least_bytes, more), *words],
        cwd=folder,
        capture_output=True,
        check=False,
        encoding="utf-8",
        timeout=60,
    )
    return Ended(done.returncode, done.stdout, done.stderr, started_in(folder))


def started_in(folder: Path) -> list[int | None]:
    codes: list[int | None] = json.loads((folder / "started.json").read_text(encoding="utf-8"))
    return codes


def test_the_process_that_waits_reads(tmp_path: Path, capture: Path) -> None:
    taken = run(tmp_path, "analyze", str(capture))
    alone = run(tmp_path, "analyze", str(capture), least_bytes=NONE_IS_LARGE)
    assert taken.code == 0
    assert taken.told == alone.told
    assert len(taken.started) == 1
    assert None not in taken.started
    assert alone.started == []


@pytest.mark.parametrize(
    "words",
    [
        ["--debug", "analyze", "--format", "json", "small.mcap"],
        ["analyze", "small.mcap", "small.mcap"],
        ["analyze", "small.mcap", "missing.mcap"],
        ["analyze", "small.mcap", "folder"],
        ["analyze", "small.mcap", "no_capture.mcap"],
        ["analyze", "no_capture.mcap"],
        ["analyze", "--", "-v.mcap"],
        ["analyze", "-v", "./-v.mcap"],
        ["analyze", "small.mcap", "--wrong"],
        ["analyze", "small.mcap", "--format", "nonsense"],
        ["analyze", "small.mcap", "--device", "nonsense"],
        ["analyze", "small.mcap", "--from", "9h"],
        ["analyze", "--help", "small.mcap"],
        ["--help", "analyze", "small.mcap"],
        ["--wrong", "analyze", "small.mcap"],
    ],
    ids=" ".join,
)
def test_every_command_ends_as_without_it(words: list[str], tmp_path: Path, capture: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "no_capture.mcap").write_bytes(bytes(range(256)))
    write(tmp_path / "-v.mcap", traffic(300))
    early = run(tmp_path, *words)
    late = run(tmp_path, *words, least_bytes=NONE_IS_LARGE)
    assert early.told == late.told
    assert early.started
    assert None not in early.started
    assert late.started == []


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["--version"],
        ["info", "small.mcap"],
        ["convert", "small.mcap", "small.log"],
        ["analyze"],
        ["analyze", "missing.mcap"],
        ["analyze", "an\nalyze", "", "*", "-", "--out"],
    ],
    ids=lambda words: " ".join(words) or "nothing",
)
def test_none_starts_where_nothing_is_to_be_read(
    words: list[str], tmp_path: Path, capture: Path
) -> None:
    assert run(tmp_path, *words).started == []


def test_none_starts_for_files_that_are_not_large(tmp_path: Path, capture: Path) -> None:
    least = 2 * capture.stat().st_size
    assert run(tmp_path, "analyze", "small.mcap", least_bytes=least).started == []
    # Together they are.
    assert run(tmp_path, "analyze", "--wrong", *["small.mcap"] * 2, least_bytes=least).started


@pytest.mark.skipif(os.name == "nt", reason="no file that its owner may not read")
@pytest.mark.skipif(os.name != "nt" and os.getuid() == 0, reason="root may read everything")
def test_a_file_that_may_not_be_read(tmp_path: Path, capture: Path) -> None:
    capture.chmod(0)
    early = run(tmp_path, "analyze", "small.mcap")
    assert early.told == run(tmp_path, "analyze", "small.mcap", least_bytes=NONE_IS_LARGE).told
    assert early.code == 2


def test_one_that_died_before_it_was_needed_is_replaced(tmp_path: Path, capture: Path) -> None:
    more = """
        def begin_and_die(module):
            begin(module)
            started[0].kill()
            started[0].wait()

        second.begin = begin_and_die
        """
    done = run(tmp_path, "analyze", "small.mcap", more=more)
    assert done.told == run(tmp_path, "analyze", "small.mcap", least_bytes=NONE_IS_LARGE).told
    assert len(done.started) == 2


def test_none_can_be_started(tmp_path: Path, capture: Path) -> None:
    more = "second._started = lambda module: None"
    done = run(tmp_path, "analyze", "small.mcap", more=more)
    assert done.told == run(tmp_path, "analyze", "small.mcap", least_bytes=NONE_IS_LARGE).told


def test_ctrl_c_while_modules_are_imported(tmp_path: Path, capture: Path) -> None:
    more = """
        def begin_and_interrupt(module):
            begin(module)
            raise KeyboardInterrupt

        second.begin = begin_and_interrupt
        """
    done = run(tmp_path, "analyze", "small.mcap", more=more)
    assert done.told == (130, "", "")
    assert len(done.started) == 1
    assert None not in done.started


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_ctrl_c_reaches_both(tmp_path: Path, capture: Path) -> None:
    more = """
        def begin_and_tell(module):
            begin(module)
            print("started", flush=True)

        second.begin = begin_and_tell
        """
    with subprocess.Popen(
        [*program(tmp_path, ONE_BYTE, more), "analyze", "small.mcap"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        start_new_session=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "started\n"
        os.killpg(process.pid, signal.SIGINT)
        _, told = process.communicate(timeout=60)
    assert (process.returncode, told) == (130, "")
    assert None not in started_in(tmp_path)


@pytest.mark.skipif(os.name == "nt", reason="a shell that closes a stream")
@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_none_takes_the_place_of_a_closed_stream(
    closed: str, tmp_path: Path, capture: Path
) -> None:
    command = shlex.join([*program(tmp_path, ONE_BYTE, ""), "analyze", "small.mcap", "--wrong"])
    done = subprocess.run(
        ["/bin/sh", "-c", f"{command} {closed}"], cwd=tmp_path, capture_output=True, check=False
    )
    assert done.returncode == 2
    assert started_in(tmp_path) == []


@pytest.mark.parametrize(
    "later",
    [
        "atexit.register(print, 'the last word')",
        "threading.Thread(target=last).start()",
        "sys.modules['duckdb'] = Said()",
    ],
)
def test_what_waits_for_the_end_happens(later: str, tmp_path: Path, capture: Path) -> None:
    more = f"""
        import threading

        def last():
            threading.main_thread().join()
            print("the last word")

        class Said:
            def __del__(self, say=print):
                say("the last word")

        {later}
        """
    ended = run(tmp_path, "analyze", str(capture), more=dedent(more))
    assert ended.code == 0
    assert ended.out.endswith("the last word\n")


def test_one_that_nobody_asks_ends_by_itself() -> None:
    process = second_process.process(READER)
    assert process is not None
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.close()
    with process.stdout:
        assert process.stdout.read() == b""
    assert process.wait(timeout=60) == 0


def test_the_end_of_those_that_wait() -> None:
    second_process.end_waiting()
    second_process.begin(READER)
    waiting = second_process._waiting[READER]
    second_process.end_waiting()
    assert waiting.returncode is not None
    assert second_process._waiting == {}
    second_process.end_waiting()
