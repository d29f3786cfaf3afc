"""`syncline devices`."""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from syncline_schemas.errors import DescriptionError, UsageError

if TYPE_CHECKING:
    from rich.table import Table

    from syncline_schemas.devices import Device

EPILOG = """\b
Examples:
  syncline devices lir-da158a
  syncline devices --check drive.eds sensor.xdd --format json
"""
_PIPE_WIDTH = 200
"""Columns of a table that goes into a pipe, where no terminal says how wide it is."""


@click.command(epilog=EPILOG)
@click.argument("names", nargs=-1, metavar="[NAME|FILE...]")
@click.option(
    "--check",
    "checked",
    type=click.Path(path_type=Path),
    multiple=True,
    metavar="FILE...",
    help="Say what is wrong with EDS, DCF, XDD, XDC or device TOML files, and what to write instead.",
)
@click.option(
    "--format",
    "output_format",
    type=click.Choice(["text", "json"]),
    default="text",
    show_default=True,
    help="Of --check.",
)
@click.option(
    "--fail-on",
    type=click.Choice(["error", "warning", "note", "never"]),
    default="never",
    show_default=True,
    help="With --check, end with exit code 1 when there is a fault as bad as this.",
)
@click.option("--all", "everything", is_flag=True, help="With --check, every fault of a kind.")
def devices(
    names: tuple[str, ...],
    checked: tuple[Path, ...],
    output_format: str,
    fail_on: str,
    everything: bool,
) -> None:
    """Show known devices, or one with its objects, scales and quirks.

    NAME is a name from the list or the path of an .eds, .dcf, .xdd or .toml file. Own devices are
    found in the folders that the environment variable SYNCLINE_DEVICES names. --check ends with exit
    code 0 when every file can be used, whatever had to be repaired, and 2 when nothing in one can.
    """
    if checked:
        _check([*checked, *_more_files(names)], output_format, fail_on, everything=everything)
        return
    if len(names) > 1:
        raise UsageError(f"one NAME at a time, not {', '.join(names)}; --check takes several files")
    if output_format != "text" or fail_on != "never" or everything:
        raise UsageError("--format, --fail-on and --all go with --check FILE")
    if names:
        from syncline_schemas.devices import load_device

        _show(load_device(names[0]))
    else:
        _print(_list_of_devices())


def _more_files(names: tuple[str, ...]) -> list[Path]:
    """What follows the first file of --check, as a shell expands `--check *.eds`."""
    from syncline_schemas.devices import is_path

    for name in names:
        if not is_path(name) and not Path(name).exists():
            raise UsageError(f"give either a NAME or --check FILE, not both: {name!r} is no file")
    return [Path(name) for name in names]


def _check(paths: list[Path], output_format: str, fail_on: str, *, everything: bool) -> None:
    from syncline_logger.device_check_view import (
        SHOWN_PER_KIND,
        check_json,
        fault_lines,
        verdict,
    )
    from syncline_schemas.devices.check import check_file
    from syncline_schemas.devices.check.kinds import SEVERITIES

    results = [check_file(path) for path in paths]
    if output_format == "json":
        click.echo(check_json(results))
    for result in (each for each in results if output_format == "text" and each.usable):
        for line in fault_lines(result, None if everything else SHOWN_PER_KIND):
            click.echo(line)
        click.echo(verdict(result), err=True)
    problems = [result.problem for result in results if result.problem is not None]
    if problems:
        raise DescriptionError("\n".join(problems))
    bad = SEVERITIES[: SEVERITIES.index(fail_on) + 1] if fail_on != "never" else ()
    if any(result.count(severity) for result in results for severity in bad):
        raise SystemExit(1)


def _list_of_devices() -> "Table":
    from syncline_schemas.devices import device_names, load_device

    table = _table("name", "device", "vendor", "kind", "node", "bit/s", "objects")
    for name in device_names():
        try:
            device = load_device(name)
        except DescriptionError as error:
            click.echo(f"{name}: {error}", err=True)
            continue
        table.add_row(
            name,
            device.title,
            device.vendor,
            device.kind,
            _text(device.default_node),
            _text(device.default_bitrate),
            str(len(device.facts)),
        )
    return table


def _show(device: "Device") -> None:
    from syncline_logger.device_sheet import objects, sections

    click.echo(
        f"{device.name}: {device.title} ({device.vendor or 'vendor unknown'}), {device.kind}"
    )
    if device.default_node is not None:
        click.echo(f"Factory settings: node {device.default_node}, {device.default_bitrate} bit/s")
    for note in device.notes:
        click.echo(f"  - {note}")
    known = objects(device)
    table = _table(*known.heads)
    for row in known.rows:
        table.add_row(*row)
    _print(table)
    for section in sections(device):
        click.echo(f"\n{section.title}")
        _print(_grid(section.rows))


def _text(value: object) -> str:
    return "" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _table(*columns: str) -> "Table":
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        table.add_column(column, overflow="fold")
    return table


def _grid(rows: Iterable[tuple[str, ...]]) -> "Table":
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    for row in rows:
        table.add_row(*row)
    return table


def _print(table: "Table") -> None:
    from rich.console import Console

    width = None if sys.stdout.isatty() else _PIPE_WIDTH
    Console(width=width, highlight=False, markup=False, emoji=False).print(table)
