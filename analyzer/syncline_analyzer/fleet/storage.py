"""Folders and object stores, as fsspec opens them."""

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import field
from functools import cached_property
from pathlib import Path
from typing import Any

import fsspec
from fsspec.core import url_to_fs
from fsspec.implementations.local import LocalFileSystem

from syncline_schemas.errors import UsageError
from syncline_schemas.records import dataclass

GLOB_MAGIC = frozenset("*?[")


@dataclass(frozen=True)
class Storage:
    """A folder, or a prefix of an object store, and what is below it.

    Attributes:
        url: absolute path of a folder with `/` between its parts, or URL; no `/` at its end.
        options: of the file system, as fsspec takes them.
    """

    url: str
    options: Mapping[str, Any] = field(default_factory=dict)

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        """Another process opens it by itself."""
        return Storage, (self.url, dict(self.options))

    @cached_property
    def fs(self) -> fsspec.AbstractFileSystem:
        """The file system; fsspec gives the same one to all of a process."""
        return open_url(self.url, self.options)[0]

    @cached_property
    def root(self) -> str:
        """Path within the file system."""
        return str(open_url(self.url, self.options)[1]).rstrip("/")

    @cached_property
    def local(self) -> bool:
        """Whether it is a folder, in which a rename is one step."""
        return isinstance(self.fs, LocalFileSystem)

    def path(self, relative: str) -> str:
        """Path of something below, for `fs`."""
        return f"{self.root}/{relative}" if relative else self.root

    def folder(self, relative: str = "") -> Path:
        """The same of a local one."""
        return Path(self.path(relative))

    def url_of(self, relative: str) -> str:
        """URL of something below, or its absolute path."""
        return f"{self.url}/{relative}"

    def read(self, relative: str) -> bytes | None:
        """Content of a file; None where there is none."""
        try:
            return bytes(self.fs.cat_file(self.path(relative)))
        except FileNotFoundError:
            return None

    def write(self, relative: str, content: bytes) -> None:
        """Write a file; a reader sees the old or the new content."""
        if not self.local:
            self.fs.pipe_file(self.path(relative), content)
            return
        target = self.folder(relative)
        target.parent.mkdir(parents=True, exist_ok=True)
        written = target.with_name(f".{target.name}.{os.getpid()}")
        written.write_bytes(content)
        written.replace(target)

    def remove(self, relative: str) -> None:
        """Remove a file, if it is there."""
        with suppress(FileNotFoundError):
            self.fs.rm_file(self.path(relative))

    def files(self, relative: str = "") -> list[str]:
        """All files below, as they are now; relative to this storage."""
        return list(self.described(relative))

    def described(self, relative: str = "") -> dict[str, Mapping[str, Any]]:
        """The same, with what the file system tells of each."""
        self.fs.invalidate_cache()
        try:
            found = self.fs.find(self.path(relative), detail=True)
        except FileNotFoundError:
            return {}
        return {str(path).removeprefix(f"{self.root}/"): about for path, about in found.items()}


def open_storage(url: str, options: Mapping[str, Any] | None = None) -> Storage:
    """A folder by its path, or an object store by its URL. Raises: UsageError."""
    fs, path = open_url(url, options or {})
    if isinstance(fs, LocalFileSystem):
        folder = absolute(path).rstrip("/")
        if Path(folder).is_file():
            raise UsageError(f"{url}: is a file; name the folder of a data set")
        return Storage(folder)
    return Storage(str(fs.unstrip_protocol(path)).rstrip("/"), options or {})


def open_url(url: str, options: Mapping[str, Any]) -> tuple[fsspec.AbstractFileSystem, str]:
    """File system of a URL or path, and the path in it.

    Options are those of object stores; a folder takes none.

    Raises:
        UsageError: there is no such file system, or the package that opens it is missing.
    """
    try:
        return url_to_fs(url, **options) if "://" in url else url_to_fs(url)  # type: ignore[no-any-return]
    except (ValueError, TypeError, ImportError) as error:
        raise UsageError(f"{url}: cannot be opened: {error}") from error


def absolute(path: str) -> str:
    """A local path, absolute and with `/` between its parts."""
    return Path(path).absolute().as_posix()
