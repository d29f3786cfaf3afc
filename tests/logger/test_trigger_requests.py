"""Asking a recorder for a trigger: by a file in its folder, by a signal."""

import errno
import os
import signal
from pathlib import Path

import pytest
from click.testing import CliRunner

from syncline_logger.cli import cli
from syncline_logger.triggers.requests import (
    HEAD,
    MAX_REQUESTS,
    MAX_TEXT,
    SIGNALLED,
    Requests,
    ask,
    trigger_requests,
)


def test_a_request_is_taken_once_and_its_words_are_told(tmp_path: Path) -> None:
    requests = Requests(tmp_path)
    told: list[str] = []
    assert ask(tmp_path, "it fell\n down", sleep=lambda _: told.extend(requests.poll()))
    assert told == ["asked for by syncline trigger: it fell down"]
    assert requests.poll() == []
    assert list(tmp_path.iterdir()) == []


def test_a_request_that_nobody_takes_is_withdrawn(tmp_path: Path) -> None:
    now = iter(range(100))
    assert not ask(tmp_path, wait_s=5, sleep=lambda _: None, clock=lambda: float(next(now)))
    assert list(tmp_path.iterdir()) == []
    assert Requests(tmp_path).poll() == []


def test_what_lies_in_the_folder_makes_nothing_raise(tmp_path: Path) -> None:
    (tmp_path / "a.trigger").write_bytes(HEAD + b"\xff\x00" * MAX_TEXT * 10)
    (tmp_path / "b.trigger").mkdir()
    (tmp_path / "c.txt").write_text("x", encoding="utf-8")
    found = Requests(tmp_path).poll()
    assert len(found) == 1
    assert found[0].isprintable()
    assert len(found[0]) < MAX_TEXT + 40
    assert Requests(tmp_path / "nowhere").poll() == []
    assert Requests(None).poll() == []


@pytest.mark.skipif(not hasattr(signal, "SIGUSR1"), reason="the system has no SIGUSR1")
def test_the_signal_asks_too() -> None:
    before = signal.getsignal(signal.SIGUSR1)
    with trigger_requests(None) as requests:
        os.kill(os.getpid(), signal.SIGUSR1)
        assert requests.poll() == [SIGNALLED]
    assert signal.getsignal(signal.SIGUSR1) is before


def test_files_of_others_stay_and_are_no_requests(tmp_path: Path) -> None:
    for number in range(MAX_REQUESTS + 5):
        (tmp_path / f"{number}.trigger").write_text("CREATE TRIGGER x", encoding="utf-8")
    (tmp_path / "z.trigger").write_bytes(HEAD + b"ours")
    assert Requests(tmp_path).poll() == ["asked for by syncline trigger: ours"]
    assert len(list(tmp_path.iterdir())) == MAX_REQUESTS + 5


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no FIFO")
def test_a_fifo_is_never_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fifo = tmp_path / "a.trigger"
    os.mkfifo(fifo)

    def refuse(*_: object) -> None:
        raise AssertionError("opened")

    monkeypatch.setattr(Path, "open", refuse)
    assert Requests(tmp_path).poll() == []
    assert fifo.exists()


def test_who_cannot_ask_by_a_file_is_told_of_the_signal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("syncline_logger.triggers.requests.replace_file", full)
    monkeypatch.setattr("syncline_logger.trigger_command.SIGNAL_ASKS", True)
    done = CliRunner().invoke(cli, ["trigger", str(tmp_path)])
    told = f"a request cannot be put into {tmp_path}: No space left on device; 'kill -USR1 PID'"
    assert str(done.exception).startswith(told)
