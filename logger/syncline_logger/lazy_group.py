"""The command group that imports a subcommand only when it is asked for."""

import importlib
from collections.abc import Callable
from typing import TYPE_CHECKING

import click

from syncline_schemas.errors import MissingExtraError
from syncline_schemas.records import dataclass

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint, EntryPoints

PLUGIN_GROUP = "syncline.commands"
"""Entry points of this group become subcommands; each names a click command."""


@dataclass(frozen=True, slots=True)
class LazyCommand:
    """A subcommand that is not imported yet.

    `short_help` is shown by `syncline --help`; `install` is the pip line that brings what the
    command needs.
    """

    short_help: str
    load: Callable[[], object]
    install: str

    def command(self, name: str) -> click.Command:
        """Import the command. Raises MissingExtraError when a package is missing."""
        try:
            command = self.load()
        except ModuleNotFoundError as error:
            raise missing_extra(name, error, self.install) from error
        if not isinstance(command, click.Command):
            raise TypeError(f"plug-in '{name}' is no click command: {command!r}")
        return command


class LazyGroup(click.Group):
    """A group of own commands and of those that other packages plug in."""

    def __init__(self, *args: object, own: dict[str, LazyCommand], **kwargs: object) -> None:
        super().__init__(*args, **kwargs)  # type: ignore[arg-type]
        self._own = own
        self._found: dict[str, LazyCommand] | None = None

    @property
    def lazy_commands(self) -> dict[str, LazyCommand]:
        """All subcommands by name; own ones cannot be replaced by a plug-in."""
        if self._found is None:
            ours = {name: each for name in OF_OUR_EXTRAS if (each := of_our_extras(name))}
            found = plugin_commands()
            self._found = found | {name: ours[name] for name in ours if name in found} | self._own
        return self._found

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names for the help, in alphabetical order."""
        return sorted(self.lazy_commands)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The imported command, None when there is none of this name."""
        lazy = self._own.get(cmd_name) or of_our_extras(cmd_name)
        lazy = lazy or self.lazy_commands.get(cmd_name)
        return lazy.command(cmd_name) if lazy else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands without importing one of them."""
        rows = [(name, self.lazy_commands[name].short_help) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def import_from(target: str) -> Callable[[], object]:
    """A loader of "module:attribute"."""

    def load() -> object:
        module, _, attribute = target.partition(":")
        return getattr(importlib.import_module(module), attribute)

    return load


OF_OUR_EXTRAS = {
    "analyze": (
        "syncline_analyzer.cli:analyze",
        "Reconstruct what happened on a bus from captures.",
    ),
    "bundle": (
        "syncline_analyzer.bundle_command:bundle",
        "Make one file for the supplier: capture, report, EDS, hashes.",
    ),
    "compare": (
        "syncline_analyzer.compare_command:compare",
        "Say what differs from a healthy capture of the same machine.",
    ),
    "convert": (
        "syncline_analyzer.cli:convert",
        "Convert between everything that can be read and written.",
    ),
    "decode": (
        "syncline_analyzer.decode_command:decode",
        "Print frames as people read CANopen.",
    ),
    "demo": ("syncline_samples.demo:demo", "Run the whole chain on a simulated bus."),
    "fleet": (
        "syncline_analyzer.fleet_command:fleet",
        "Analyze the captures of many machines and ask about all of them.",
    ),
    "info": ("syncline_analyzer.cli:info", "Say what is in a capture and whether it is whole."),
    "layout": (
        "syncline_analyzer.layout_command:layout",
        "Write a layout for Foxglove or Rerun that fits a capture.",
    ),
    "view": ("syncline_analyzer.cli:view", "Analyze captures and open the Rerun viewer on them."),
}
"""Target and help of the plug-ins of our own distribution, as its entry points name them.

To look through all that is installed takes longer than all that is imported before a command. A
foreign plug-in shows the summary of its distribution.
"""
_EXTRA = 'pip install "syncline[analyzer]"'


def of_our_extras(name: str) -> LazyCommand | None:
    """A subcommand of our own distribution, found without a look at what is installed."""
    if name not in OF_OUR_EXTRAS:
        return None
    target, short_help = OF_OUR_EXTRAS[name]
    return LazyCommand(short_help, import_from(target), _EXTRA)


def entry_points(group: str) -> "EntryPoints":
    """Those of all installed distributions."""
    from importlib import metadata

    return metadata.entry_points(group=group)


def plugin_commands() -> dict[str, LazyCommand]:
    """Subcommands that installed distributions bring, by name."""
    return {entry.name: _plugin(entry) for entry in entry_points(group=PLUGIN_GROUP)}


def _plugin(entry: "EntryPoint") -> LazyCommand:
    metadata = entry.dist.metadata if entry.dist else None
    if metadata is None:
        return LazyCommand("", entry.load, "")
    name, summary = metadata["Name"], metadata["Summary"] or ""
    extras = ",".join(metadata.get_all("Provides-Extra") or ())
    requirement = f'"{name}[{extras}]"' if extras else name
    return LazyCommand(summary, entry.load, f"pip install {requirement}")


def missing_extra(name: str, error: ModuleNotFoundError, install: str) -> MissingExtraError:
    """What to tell somebody whose installation lacks a package of `syncline NAME`."""
    return MissingExtraError(
        f"'syncline {name}' needs the package '{error.name}', which is not installed;"
        f" type: {install}"
    )
