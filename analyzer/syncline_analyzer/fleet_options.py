"""Options that the commands about fleets have in common."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click

from syncline_schemas.errors import MissingExtraError, UsageError

INSTALL = 'pip install "syncline[fleet]"'
STORAGE = click.option(
    "--storage-option",
    "storage_pairs",
    multiple=True,
    metavar="KEY=VALUE",
    help="Option of the object store, as of 'syncline fleet analyze'.",
)
MACHINE = click.option(
    "--machine", metavar="NAME", help="Captures of this machine; * and ? stand for others."
)
SINCE = click.option(
    "--since", metavar="DATE", help="Captures that began at this date or time or later (UTC)."
)
UNTIL = click.option(
    "--until", metavar="DATE", help="Captures that began before this date or time."
)
NO_DATA = "{}: no data set is here; 'syncline fleet analyze' writes one"


@contextmanager
def fleet_extra() -> Iterator[None]:
    """Say which extra is missing where a package of it is. Raises: MissingExtraError."""
    try:
        yield
    except ModuleNotFoundError as error:
        if str(error.name).startswith("syncline"):
            raise
        raise MissingExtraError(
            f"'syncline fleet' needs the package '{error.name}', which is not installed;"
            f" type: {INSTALL}"
        ) from error


def storage_options(pairs: tuple[str, ...]) -> dict[str, Any]:
    """Options of file systems from KEY=VALUE; a value is JSON where it can be. Raises: UsageError.

    >>> storage_options(("anon=true", 'client_kwargs={"region_name": "eu"}', "key=me"))
    {'anon': True, 'client_kwargs': {'region_name': 'eu'}, 'key': 'me'}
    """
    options = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not (key and equals):
            raise UsageError(f"--storage-option {pair}: write it as KEY=VALUE")
        try:
            options[key] = json.loads(value)
        except ValueError:
            options[key] = value
    return options
