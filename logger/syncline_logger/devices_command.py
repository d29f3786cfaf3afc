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
    from syncline_schemas.devices.check import FileCheck

EPILOG = """\b
Examples:
  syncline devices lir-da158a
  syncline devices --check drive.eds
"""
_PIPE_WIDTH = 200
"""Columns of a table that goes into a pipe, where no terminal says how wide it is."""


@click.command(epilog=EPILOG)
@click.argument("name", required=False)
@click.option(
    "--check",
    "checked",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Say what is wrong with an EDS, DCF or device TOML file.",
)
def devices(name: str | None, checked: Path | None) -> None:
    """Show known devices, or one with its objects, scales and quirks.

    NAME is a name from the list or the path of an .eds, .dcf or .toml file. Own devices are found
    in the folders that the environment variable SYNCLINE_DEVICES names. --check ends with exit
    code 0 when the file can be used, whatever had to be repaired, and 2 when nothing in it can.
    """
    from syncline_schemas.devices import load_device

    if checked is not None and name is not None:
        raise UsageError("give either a NAME or --check FILE, not both")
    if checked is not None:
        _check(checked)
    elif name is None:
        _print(_list_of_devices())
    else:
        _show(load_device(name))


def _check(path: Path) -> None:
    from syncline_schemas.devices.check import check_file

    result = check_file(path)
    if result.problem is not None:
        raise DescriptionError(result.problem)
    for warning in result.warnings:
        click.echo(f"{path.name}: {warning}")
    click.echo(_verdict(result), err=True)


def _verdict(result: "FileCheck") -> str:
    count = len(result.warnings)
    said = "no faults" if not count else f"{count} fault{'s' if count > 1 else ''}, listed above"
    return f"{result.path}: can be used: {result.title}, {result.variables} objects; {said}"


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
