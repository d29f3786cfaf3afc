"""Names that tell the same capture, the same content and the same analysis from others."""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from io import BufferedReader
from pathlib import Path

PACKAGES = ("syncline_schemas", "syncline_analyzer")
"""What an analysis depends on."""
_ID_DIGITS = 15
_SOURCE_ENDINGS = {".py", ".toml", ".eds", ".dcf", ".xdd", ".json"}


def capture_id(*names: str) -> str:
    """Id of a capture: `c` and 15 hexadecimal digits, so that no reader takes it for a number.

    Args:
        names: recording id and host of the recorder, or content and machine.
    """
    return f"c{short_hash(*names)}"


def short_hash(*names: str) -> str:
    """15 hexadecimal digits of names, in their order."""
    return hashlib.sha256("\0".join(names).encode()).hexdigest()[:_ID_DIGITS]


def content_hash(digests: Sequence[str]) -> str:
    """SHA-256 of a capture of these files: of a single one its own."""
    if len(digests) == 1:
        return digests[0]
    return hashlib.sha256("\n".join(digests).encode()).hexdigest()


def file_digest(stream: BufferedReader) -> str:
    """SHA-256 of what a stream holds."""
    return hashlib.file_digest(stream, "sha256").hexdigest()


@cache
def code_version() -> str:
    """Version of Syncline and a digest of the source that is installed: what analyses depend on."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        for name, content in _sources(_folder(package)):
            digest.update(f"{package}/{name}\0{len(content)}\0".encode())
            digest.update(content)
    return f"{version('syncline')}+{digest.hexdigest()[:12]}"


def analysis_version(settings: Iterable[str]) -> str:
    """The same together with what a user set: other settings are another analysis."""
    texts = [text for text in settings if text]
    return f"{code_version()}.{short_hash(*texts)[:8]}" if texts else code_version()


def _folder(package: str) -> Path:
    spec = find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent


def _sources(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Source files and device files by name, the same on every system."""
    for path in sorted(folder.rglob("*"), key=lambda each: each.relative_to(folder).as_posix()):
        if path.suffix in _SOURCE_ENDINGS and path.is_file():
            yield path.relative_to(folder).as_posix(), path.read_bytes().replace(b"\r\n", b"\n")
