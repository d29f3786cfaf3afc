"""docs/recording.md: its commands and files are what the program takes."""

import re
import shlex
from pathlib import Path

import click
import pytest

from syncline_logger.cli import cli
from syncline_logger.config import load_config
from syncline_logger.record_command import record

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "recording.md").read_text(encoding="utf-8")


def commands() -> list[str]:
    """Every `syncline ...` line in the page's shell blocks, without comments."""
    blocks = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    lines = [line.split(" # ")[0].strip() for block in blocks for line in block.splitlines()]
    return [line for line in lines if re.match(r"(/opt/syncline/bin/)?syncline ", line)]


@pytest.mark.parametrize("line", commands())
def test_a_command_of_the_page_is_understood(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "logger.toml").write_text("[[bus]]\ninterface = 'virtual'\n", encoding="utf-8")
    _, name, *words = shlex.split(line.replace("/etc/syncline/", ""))
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    command.make_context(name, words)


def test_there_are_commands_for_every_family() -> None:
    for interface in ("socketcan", "pcan", "kvaser", "vector", "ixxat", "slcan", "gs_usb"):
        assert any(f"-i {interface} " in line for line in commands())


def test_the_files_that_the_page_names_are_there() -> None:
    named = set(re.findall(r"\.\./deploy/([\w.-]+)", PAGE))
    named |= set(re.findall(r"deploy/([\w.-]+\.\w+) /", PAGE))
    assert named == {each.name for each in (ROOT / "deploy").iterdir()}


def test_the_example_configuration_is_right() -> None:
    assert load_config(ROOT / "deploy" / "logger.toml", record.params).problems == ()


def test_keys_of_the_configuration_that_the_page_names_exist() -> None:
    keys = {re.sub(r"^#", "", line).split(" = ")[0] for line in _example() if " = " in line}
    for key in re.findall(r"`(\w+) = ", PAGE):
        assert key in keys, key


def _example() -> list[str]:
    return (ROOT / "deploy" / "logger.toml").read_text(encoding="utf-8").splitlines()
