"""Which files of folders, globs and object stores may be captures."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any

from fsspec.implementations.local import LocalFileSystem

from syncline_analyzer.fleet.storage import GLOB_MAGIC, Storage, absolute, open_url
from syncline_analyzer.readers.formats import READ_FORMATS
from syncline_schemas.errors import UsageError
from syncline_schemas.records import dataclass

PACKED = (".gz", ".zst")
ENDINGS = frozenset({ending for form in READ_FORMATS for ending in form.endings} | {".zip"})
"""Of files that may be captures, also with one of `PACKED` behind."""
_LOOSE = frozenset({".txt", ".csv", ".log", ".zip", ".cap"})
"""Endings of many things that are no captures."""
_MODIFIED = ("mtime", "LastModified", "last_modified", "modified", "modify", "updated", "created")
_ETAG = ("ETag", "etag", "md5Hash", "content_md5")


@dataclass(frozen=True, slots=True)
class Found:
    """A file that may be a capture, as it was listed.

    Attributes:
        url: URL, or absolute path of a local file.
        modified_ns, etag: as far as the file system tells.
        sure: whether somebody said, or its ending says, that it is a capture.
    """

    url: str
    size_bytes: int
    modified_ns: int | None = None
    etag: str | None = None
    sure: bool = True


def find_captures(
    sources: Sequence[str], out: Storage, options: Mapping[str, Any] | None = None
) -> list[Found]:
    """All files that may be captures, each once, by URL; what is below `out` is left out.

    Args:
        sources: folders (with all below), files, globs, or URLs of these.
        options: of the file systems of URLs, as fsspec takes them.

    Raises:
        UsageError: there is nothing at a source, or it cannot be opened.
    """
    own = f"{out.url}/"
    found = {each.url: each for source in sources for each in _of(source, options or {})}
    return [found[url] for url in sorted(found) if not url.startswith(own)]


def _of(source: str, options: Mapping[str, Any]) -> Iterator[Found]:
    fs, path = open_url(source, options)
    local = isinstance(fs, LocalFileSystem)
    path = absolute(path) if local else path
    fs.invalidate_cache()
    try:
        named, listed = _listed(fs, path)
    except OSError as error:
        raise UsageError(f"{source}: cannot be read: {error.strerror or error}") from error
    if listed is None:
        raise UsageError(f"{source}: is not there; name a folder, a file, a glob or a URL")
    for info in listed:
        name = str(info["name"])
        ending = _ending(name)
        if info.get("type") == "file" and (named or ending in ENDINGS):
            url = absolute(name) if local else str(fs.unstrip_protocol(name))
            yield Found(
                # No table holds a name that is no UTF-8: such a file fails, and is told by this one.
                url.encode(errors="backslashreplace").decode(),
                int(info.get("size") or 0),
                modified_ns_of(info),
                etag_of(info),
                named or ending not in _LOOSE,
            )


def _listed(fs: Any, path: str) -> tuple[bool, Iterable[Mapping[str, Any]] | None]:
    """What is there, and whether its files were named as captures; None where nothing is."""
    if GLOB_MAGIC & set(path):
        last = path.rsplit("/", 1)[-1]
        return bool(last.strip("*")), fs.glob(path, detail=True).values() or None
    if fs.isfile(path):
        return True, [fs.info(path)]
    if fs.isdir(path):
        return False, fs.find(path, detail=True).values()
    return False, None


def _ending(name: str) -> str:
    """Ending of a file's name, without what it is packed with.

    >>> _ending("/a/night.LOG.gz"), _ending("s3://b/x.y/readme")
    ('.log', '')
    """
    base = name.rsplit("/", 1)[-1].lower()
    for packed in PACKED:
        base = base.removesuffix(packed)
    return base[base.rfind(".") :] if "." in base else ""


def modified_ns_of(info: Mapping[str, Any]) -> int | None:
    """When a file was changed, as its file system describes it [ns since 1970]."""
    value = next((info[key] for key in _MODIFIED if info.get(key) is not None), None)
    if isinstance(value, datetime):
        value = value.timestamp()
    return round(value * 1e9) if isinstance(value, int | float) else None


def etag_of(info: Mapping[str, Any]) -> str | None:
    """What an object store calls this content of a file."""
    value = next((info[key] for key in _ETAG if info.get(key)), None)
    return None if value is None else str(value).strip('"')
