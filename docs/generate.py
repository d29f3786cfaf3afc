"""Writes the pages made from the code: `uv run python -m docs.generate`.

`commands.md` comes from the commands' own --help, `findings.md` from the rules.
"""

import sys
from itertools import groupby
from pathlib import Path

import click

from syncline_analyzer.findings import RULES
from syncline_analyzer.findings.bonds import BONDS
from syncline_analyzer.findings.rule import Rule
from syncline_logger.cli import cli

FOLDER = Path(__file__).parent
FINDINGS_HEADER = """# Findings

Made from the rules by `python -m docs.generate`; a test keeps it true. A finding says what a service engineer would
write in a report: what happened, the frames that prove it, the likely cause and what to check next. Findings that follow
from another one become links of its `chain`: one story, told at its root. Severities: `error` is a fault that stops or
endangers the machine, `warning` something to look at, `info` a note. What a finding rests on that was only assumed stands
in `assumed`.
"""
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


def findings_page() -> str:
    """Every rule by family: meaning, evidence, guards against false alarms, and what it explains."""
    by_id = sorted(RULES, key=lambda rule: rule.id)
    sections = [FINDINGS_HEADER, f"{len(by_id)} findings are known.\n"]
    for family, rules in groupby(by_id, key=lambda rule: rule.id.partition(".")[0]):
        sections += [f"## {family}\n", *(_rule_section(rule) for rule in rules)]
    return "\n".join(sections)


def _rule_section(rule: Rule) -> str:
    effects = sorted({bond.effect for bond in BONDS if bond.cause == rule.id})
    lines = [
        f"### {rule.id}\n",
        f"{rule.meaning}\n",
        f"- Evidence: {rule.evidence}",
        *(f"- Guard: {guard}" for guard in rule.guards),
    ]
    if effects:
        lines.append(f"- May explain: {', '.join(f'`{effect}`' for effect in effects)}")
    if rule.untimed:
        lines.append("- Also judged on logs without times.")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    for name, page in (("commands.md", commands_page()), ("findings.md", findings_page())):
        (folder / name).write_text(page, encoding="utf-8", newline="\n")
