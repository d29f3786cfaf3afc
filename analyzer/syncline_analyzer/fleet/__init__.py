"""Many captures of many machines, analyzed on a Dask cluster into one parquet data set."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from syncline_analyzer.fleet.ask import Fleet

__all__ = ["open_fleet"]


def open_fleet(url: str, options: Mapping[str, Any] | None = None) -> "Fleet":
    """Open a data set that `syncline fleet analyze` wrote, to ask it.

    Args:
        url: its folder or URL.
        options: of the file system of a URL, as fsspec takes them.

    Raises:
        UsageError: it cannot be opened.
    """
    from syncline_analyzer.fleet.ask import Fleet

    return Fleet.open(url, options)
