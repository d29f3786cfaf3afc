"""What is in a data set: a look at its folders, and at no file.

Of a local one only three levels of folders are gone through; an object store lists everything.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import field
from pathlib import Path
from typing import Self

from syncline_analyzer.fleet.layout import (
    CAPTURES_FILE,
    FAILURES,
    PACKS,
    STAGING,
    Partition,
)
from syncline_analyzer.fleet.source import etag_of, modified_ns_of
from syncline_analyzer.fleet.storage import Storage
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass


class PackFiles(NamedTuple):
    """The files of a pack.

    Attributes:
        sizes: bytes by table; without `captures` the pack does not stand.
        modified_ns: when the last of them was written [ns since 1970], where that is told.
    """

    sizes: dict[str, int]
    modified_ns: int | None


@dataclass(frozen=True, slots=True)
class Listing:
    """What stands in a data set.

    Attributes:
        captures: by partition, the stamp of `captures.parquet`: another one after each change, None
            where the file system tells nothing of changes.
        failures: keys.
        packs: by name.
    """

    captures: Mapping[Partition, str | None] = field(default_factory=dict)
    failures: tuple[str, ...] = ()
    packs: Mapping[str, PackFiles] = field(default_factory=dict)

    @classmethod
    def of(cls, storage: Storage) -> Self:
        """Look at a data set; one that is not there is empty."""
        captures: dict[Partition, str | None] = {}
        packs: dict[str, PackFiles] = {}
        failures = []
        found = _local(storage.folder()) if storage.local else _remote(storage)
        for path, size, changed, modified_ns in found:
            folder, _, name = path.rpartition("/")
            table = name.removesuffix(".parquet")
            if folder == FAILURES:
                failures.append(table)
            elif folder.startswith(f"{PACKS}/"):
                pack = folder.removeprefix(f"{PACKS}/")
                before = packs.get(pack, PackFiles({}, None))
                latest_ns = max(before.modified_ns or 0, modified_ns or 0) or None
                packs[pack] = PackFiles(before.sizes | {table: size}, latest_ns)
            elif name == CAPTURES_FILE and (partition := Partition.of_path(folder)):
                captures[partition] = None if changed is None else f"{size} {changed}"
        return cls(captures, tuple(sorted(failures)), packs)


_Found = Iterator[tuple[str, int, str | int | None, int | None]]
"""Path, size, what is another one after a change, and the time of that [ns since 1970]."""


def _local(root: Path) -> _Found:
    for folder in _folders(root):
        name = folder.name
        if name == FAILURES:
            yield from _parquet_files(folder, name)
        elif name == PACKS:
            for pack in _folders(folder):
                yield from _parquet_files(pack, f"{name}/{pack.name}")
        elif name != STAGING:
            for date in _folders(folder):
                for capture in _folders(date):
                    yield from _standing(capture, f"{name}/{date.name}/{capture.name}")


def _folders(path: os.PathLike[str]) -> list["os.DirEntry[str]"]:
    try:
        with os.scandir(path) as entries:
            return [entry for entry in entries if entry.is_dir()]
    except OSError:
        return []  # Taken away meanwhile, or none of ours.


def _parquet_files(path: os.PathLike[str], relative: str) -> _Found:
    with suppress(OSError), os.scandir(path) as entries:
        for entry in entries:
            if entry.name.endswith(".parquet"):
                about = entry.stat()
                changed_ns = about.st_mtime_ns
                yield f"{relative}/{entry.name}", about.st_size, changed_ns, changed_ns


def _standing(folder: "os.DirEntry[str]", relative: str) -> _Found:
    # Of thousands of folders: paths as text.
    with suppress(OSError):
        about = os.stat(os.path.join(folder.path, CAPTURES_FILE))
        changed_ns = about.st_mtime_ns
        yield f"{relative}/{CAPTURES_FILE}", about.st_size, changed_ns, changed_ns


def _remote(storage: Storage) -> _Found:
    for path, about in storage.described().items():
        if path.endswith(".parquet"):
            modified_ns = modified_ns_of(about)
            yield path, int(about.get("size") or 0), etag_of(about) or modified_ns, modified_ns
