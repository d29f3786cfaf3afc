"""The zip file of a bundle: written the same each time, read with care."""

import hashlib
import json
import re
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from syncline_schemas.errors import CaptureError
from syncline_schemas.records import dataclass

MANIFEST = "manifest.json"
SCHEMA = "syncline.bundle/1"
CAPTURE = "capture.mcap"
MAX_MANIFEST_BYTES = 4 << 20
MAX_MEMBERS = 1000
MAX_CAPTURE_BYTES = 64 << 30
"""A capture beyond this is not unpacked: it is no case any more, or a trap."""

_DATE = (1980, 1, 1, 0, 0, 0)
_BLOCK = 1 << 20
_NAME = re.compile(r"[A-Za-z0-9_.-]+(?:/[A-Za-z0-9_.-]+)?")


@dataclass(frozen=True, slots=True)
class Member:
    """One file of a bundle: its name within, where its bytes are, and what it is."""

    name: str
    data: bytes | Path
    what: str


def safe_name(text: str) -> str:
    """A file name within a bundle: no folder, no "..", only letters, digits, `_`, `-` and `.`.

    >>> safe_name("../../etc/pass wd"), safe_name(chr(92) + "boot.eds"), safe_name("..")
    ('pass_wd', 'boot.eds', 'file')
    """
    base = re.split(r"[/\\]", text)[-1]
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", base).lstrip(".")[:100] or "file"


def write_bundle(stream: BinaryIO, members: Sequence[Member], facts: Mapping[str, Any]) -> None:
    """Write the members and a manifest with the SHA-256 of each; equal contents give equal bytes."""
    listed = []
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for member in members:
            digest, size = _write(archive, member.name, member.data)
            row = {"name": member.name, "bytes": size, "sha256": digest, "what": member.what}
            listed.append(row)
        manifest = {"schema": SCHEMA, **facts, "members": listed}
        _write(archive, MANIFEST, (json.dumps(manifest, indent=2) + "\n").encode())


def _write(archive: zipfile.ZipFile, name: str, data: bytes | Path) -> tuple[str, int]:
    info = zipfile.ZipInfo(name, _DATE)
    info.compress_type = zipfile.ZIP_DEFLATED
    info.create_system = 3
    info.external_attr = 0o644 << 16
    digest, size = hashlib.sha256(), 0
    with archive.open(info, "w", force_zip64=isinstance(data, Path)) as out:
        for block in _blocks(data):
            digest.update(block)
            size += len(block)
            out.write(block)
    return digest.hexdigest(), size


def _blocks(data: bytes | Path) -> Any:
    if isinstance(data, bytes):
        yield data
        return
    with data.open("rb") as file:
        while block := file.read(_BLOCK):
            yield block


def sha256_of(path: Path) -> str:
    """SHA-256 of a file. Raises: OSError."""
    digest = hashlib.sha256()
    for block in _blocks(path):
        digest.update(block)
    return digest.hexdigest()


def read_manifest(path: Path) -> dict[str, Any]:
    """The manifest of a bundle, with every name and size in it looked at.

    Raises:
        CaptureError: the file is no bundle, or names or sizes in it make no sense.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return _manifest(path, archive)
    except (zipfile.BadZipFile, zlib.error, RuntimeError, EOFError) as error:
        raise CaptureError(f"{path}: is no ZIP archive that can be read: {error}") from error
    except OSError as error:
        if isinstance(error, CaptureError):
            raise
        raise CaptureError(f"{path}: cannot be opened: {error.strerror or error}") from error


def _manifest(path: Path, archive: zipfile.ZipFile) -> dict[str, Any]:
    if MANIFEST not in archive.namelist():
        raise CaptureError(
            f"{path}: is a ZIP archive, but no bundle of Syncline (it has no {MANIFEST});"
            " unpack it and name the captures in it"
        )
    if archive.getinfo(MANIFEST).file_size > MAX_MANIFEST_BYTES:
        raise CaptureError(f"{path}: its {MANIFEST} is absurdly large")
    try:
        with archive.open(MANIFEST) as file:
            text = file.read(MAX_MANIFEST_BYTES + 1)
        manifest = json.loads(text)
        members = manifest["members"]
        good = len(text) <= MAX_MANIFEST_BYTES and manifest["schema"] == SCHEMA
        good = good and len(members) <= MAX_MEMBERS and all(map(_is_member, members))
    except (
        ValueError,
        KeyError,
        TypeError,
        RecursionError,
        zlib.error,
        zipfile.BadZipFile,
    ) as error:
        raise CaptureError(f"{path}: its {MANIFEST} cannot be read: {error}") from error
    if not good:
        raise CaptureError(f"{path}: its {MANIFEST} lists what no bundle of Syncline holds")
    return dict(manifest)


def _is_member(row: Any) -> bool:
    name, size = row["name"], row["bytes"]
    plain = isinstance(name, str) and _NAME.fullmatch(name) and ".." not in name.split("/")
    return bool(plain) and type(size) is int and size >= 0 and isinstance(row["sha256"], str)


def check_bundle(path: Path) -> list[str]:
    """What is wrong with a bundle, a line for each; nothing when every hash is right.

    Raises:
        CaptureError: the file is no bundle.
    """
    rows = {row["name"]: row for row in read_manifest(path)["members"]}
    wrong = []
    with zipfile.ZipFile(path) as archive:
        there = archive.namelist()
        for name in sorted({*there, *rows}):
            if there.count(name) > 1:
                wrong.append(f"{name!r} is in it twice")
            elif name not in there:
                wrong.append(f"{name!r} is missing")
            elif (
                name in rows and _digest(archive, name, rows[name]["bytes"]) != rows[name]["sha256"]
            ):
                wrong.append(f"{name!r} is not what was put in: its SHA-256 is another one")
            elif name not in rows and name != MANIFEST:
                wrong.append(f"{name!r} was added: the manifest does not list it")
    return wrong


def _digest(archive: zipfile.ZipFile, name: str, size: int) -> str | None:
    """SHA-256 of a member, None where it is not of its size or cannot be read."""
    if archive.getinfo(name).file_size != size:
        return None
    digest, left = hashlib.sha256(), size
    try:
        with archive.open(name) as file:
            while left >= 0 and (block := file.read(_BLOCK)):
                digest.update(block)
                left -= len(block)
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError):
        return None
    return digest.hexdigest() if left == 0 else None


def unpack_capture(path: Path, target: Path) -> None:
    """Write the capture of a bundle to `target`; nothing else of it is unpacked.

    Raises:
        CaptureError: the file is no bundle, its capture is not what the manifest says, or absurdly
            large.
    """
    rows = {row["name"]: row for row in read_manifest(path)["members"]}
    row = rows.get(CAPTURE)
    if row is None:
        raise CaptureError(f"{path}: the bundle lists no {CAPTURE}")
    if row["bytes"] > MAX_CAPTURE_BYTES:
        raise CaptureError(
            f"{path}: its {CAPTURE} would be {row['bytes']:,} bytes; unpack it first"
        )
    digest, left = hashlib.sha256(), row["bytes"]
    try:
        with (
            zipfile.ZipFile(path) as archive,
            archive.open(CAPTURE) as file,
            target.open("wb") as out,
        ):
            while left >= 0 and (block := file.read(min(_BLOCK, left + 1))):
                digest.update(block)
                left -= len(block)
                out.write(block)
    except (KeyError, zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as error:
        raise CaptureError(f"{path}: its {CAPTURE} cannot be unpacked: {error}") from error
    except OSError as error:
        raise CaptureError(f"{path}: cannot be unpacked: {error.strerror or error}") from error
    if left or digest.hexdigest() != row["sha256"]:
        raise CaptureError(
            f"{path}: its {CAPTURE} is not the one that was put in; see 'syncline bundle --check'"
        )
