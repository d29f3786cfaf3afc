"""What is in a data set: a look at its folders, and at no file.

Of a local one only three levels of folders are gone through; an object store lists everything.
"""

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from syncline_analyzer.fleet.layout import (
    CAPTURES_FILE,
    FAILURES,
    PACKS,
    STAGING,
    Partition,
)
from syncline_analyzer.fleet.source import etag_of, modified_ns_of
from syncline_analyzer.fleet.storage import Storage


@dataclass(frozen=True, slots=True)
class Listing:
    """What stands in a data set.

    Attributes:
        captures: by partition, the stamp of `captures.parquet`: another one after each change.
        failures: keys.
        packs: names.
    """

    captures: Mapping[Partition, str] = field(default_factory=dict)
    failures: tuple[str, ...] = ()
    packs: tuple[str, ...] = ()

    @classmethod
    def of(cls, storage: Storage) -> Self:
        """Look at a data set; one that is not there is empty."""
        captures, failures, packs = {}, [], []
        found = _local(storage.folder()) if storage.local else _remote(storage)
        for path, stamp in found:
            folder, _, name = path.rpartition("/")
            if folder == FAILURES:
                failures.append(name.removesuffix(".parquet"))
            elif folder.startswith(f"{PACKS}/"):
                packs.append(folder.removeprefix(f"{PACKS}/"))
            elif partition := Partition.of_path(folder):
                captures[partition] = stamp
        return cls(captures, tuple(sorted(failures)), tuple(sorted(packs)))


def _local(root: Path) -> Iterator[tuple[str, str]]:
    for folder in _folders(root):
        name = folder.name
        if name == FAILURES:
            yield from ((f"{name}/{each}", "") for each in _parquet_files(folder))
        elif name == PACKS:
            for pack in _folders(folder):
                yield from _standing(pack, f"{name}/{pack.name}")
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


def _parquet_files(path: os.PathLike[str]) -> list[str]:
    with os.scandir(path) as entries:
        return [entry.name for entry in entries if entry.name.endswith(".parquet")]


def _standing(folder: "os.DirEntry[str]", relative: str) -> Iterator[tuple[str, str]]:
    try:
        about = os.stat(os.path.join(folder.path, CAPTURES_FILE))
    except OSError:
        return
    yield f"{relative}/{CAPTURES_FILE}", f"{about.st_size} {about.st_mtime_ns}"


def _remote(storage: Storage) -> Iterator[tuple[str, str]]:
    for path, info in storage.described().items():
        failed = path.startswith(f"{FAILURES}/") and path.endswith(".parquet")
        if failed or path.endswith(f"/{CAPTURES_FILE}"):
            yield path, _stamp(info)


def _stamp(info: Mapping[str, Any]) -> str:
    return f"{info.get('size')} {etag_of(info) or modified_ns_of(info)}"
