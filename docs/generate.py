"""Writes docs/commands.md from the commands' own --help: `uv run python -m docs.generate`."""

import sys
from pathlib import Path

import click

from syncline_logger.cli import cli

TARGET = Path(__file__).parent / "commands.md"
HEADER = """# Commands

Made from `--help` by `python -m docs.generate`; a test keeps it true. Data goes to stdout, words and progress to
stderr. Exit codes: 0 fine, 1 the wanted result was not reached (`--check`, a damaged capture that could be read only in
part), 2 wrong use or unreadable input, 130 interrupted.
"""


def commands_page() -> str:
    """The whole page: `syncline --help`, then each command in the order of their names."""
    root = click.Context(
        cli,
        info_name="syncline",
        max_content_width=100,
        terminal_width=100,
        **cli.context_settings,
    )
    sections = [HEADER, _section("syncline", root)]
    for name in sorted(cli.list_commands(root)):
        command = cli.get_command(root, name)
        assert command is not None
        context = click.Context(command, parent=root, info_name=name, terminal_width=100)
        sections.append(_section(f"syncline {name}", context))
    return "\n".join(sections)


def _section(title: str, context: click.Context) -> str:
    return f"## {title}\n\n```\n{context.get_help().rstrip()}\n```\n"


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else TARGET
    target.write_text(commands_page(), encoding="utf-8", newline="\n")
