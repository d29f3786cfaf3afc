"""Bytes of a capture file, unpacked on the way, and whole lines in blocks."""

import zlib
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO, cast

from syncline_schemas.errors import CaptureError

GZIP_MAGIC = b"\x1f\x8b"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
HEAD_BYTES = 256 * 1024
BLOCK_BYTES = 2 * 1024 * 1024
MAX_LINE_BYTES = 64 * 1024
"""A longer stretch without a line end is cut: it is no text log."""
_BOMB_BYTES = 64 * 1024 * 1024
_BOMB_RATIO = 250
"""Logs of nothing but equal frames shrink to a fortieth; a file of zeros to a thousandth and less."""


class CaptureSource:
    """The unpacked bytes of a file; a fault of the packing ends them and is kept in `damage`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage: str | None = None
        self._given = 0
        try:
            self._file = _unpacked(path)
            self._plain = isinstance(self._file, BufferedReader)
        except OSError as error:
            raise CaptureError(f"{path}: cannot be opened: {error.strerror or error}") from error

    def read(self, size: int) -> bytes:
        """Up to `size` bytes, fewer only at the end (or where the packed data are damaged)."""
        parts: list[bytes] = []
        while size > 0:
            part = self._read_once(size)
            if not part:
                break
            parts.append(part)
            size -= len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def _read_once(self, size: int) -> bytes:
        if self.damage is not None:
            return b""
        try:
            # A large request loses everything before a fault of the packing in the same request.
            data = self._file.read(size if self._plain else min(size, HEAD_BYTES))
            self._given += len(data)
            if not self._plain and self._given > _BOMB_BYTES:
                self._check_growth()
            return data
        except CaptureError:
            raise
        except EOFError:
            self.damage = "the packed file ends early"
        except (zlib.error, OSError, ValueError) as error:
            self.damage = f"the packed data are damaged: {error}"
        except Exception as error:  # zstandard.ZstdError, whose module is loaded only for .zst
            if type(error).__module__.split(".")[0] != "zstandard":
                raise
            self.damage = f"the packed data are damaged: {error}"
        return b""

    def _check_growth(self) -> None:
        if self._given > _BOMB_RATIO * self.path.stat().st_size:
            raise CaptureError(
                f"{self.path}: unpacks to more than {_BOMB_RATIO} times its size, which no log does;"
                " it is not read any further"
            )

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _unpacked(path: Path) -> BinaryIO:
    file = path.open("rb")
    magic = file.read(4)
    file.seek(0)
    if magic[:2] == GZIP_MAGIC:
        return cast(BinaryIO, _GzipStream(file))
    if magic == ZSTD_MAGIC:
        import zstandard

        reader = zstandard.ZstdDecompressor().stream_reader(
            file, read_across_frames=True, closefd=True
        )
        return cast(BinaryIO, reader)
    return file


class _GzipStream:
    """Gzip that delivers every byte before a fault; `gzip.GzipFile` keeps up to a block back."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._inflate = zlib.decompressobj(wbits=31)

    def read(self, size: int) -> bytes:
        while True:
            if self._inflate.eof:
                rest = self._inflate.unused_data.lstrip(b"\0") or self._file.read(4096).lstrip(
                    b"\0"
                )
                if not rest:
                    return b""
                self._inflate = zlib.decompressobj(wbits=31)
            else:
                rest = self._inflate.unconsumed_tail or self._file.read(65536)
                if not rest:
                    raise EOFError
            data = self._inflate.decompress(rest, size)
            if data:
                return data

    def close(self) -> None:
        self._file.close()


class LineSource:
    """Text of a log as blocks of whole lines; UTF-16 and byte-order marks are taken out."""

    def __init__(self, source: CaptureSource, block_bytes: int = BLOCK_BYTES) -> None:
        self._source = source
        self._block_bytes = block_bytes
        raw = source.read(HEAD_BYTES)
        self._decoding = _utf16(raw)
        self._bare_cr = False
        self.head = self._plain(raw)
        self._bare_cr = b"\n" not in self.head and b"\r" in self.head
        if self._bare_cr:
            self.head = self.head.replace(b"\r", b"\n")

    @property
    def damage(self) -> str | None:
        """What is wrong with the packing of the file, once it was met."""
        return self._source.damage

    def _plain(self, raw: bytes) -> bytes:
        if self._decoding is not None:
            raw = self._decoding.decode(raw).encode("utf-8", "replace")
        if raw.startswith(b"\xef\xbb\xbf"):
            raw = raw[3:]
        return raw.replace(b"\r", b"\n") if self._bare_cr else raw

    def blocks(self) -> Iterator[bytes]:
        """Blocks of whole lines in file order; only the last may lack its line end.

        A stretch of more than `MAX_LINE_BYTES` without a line end is a block of its own.
        """
        rest = b""
        for part in self._parts():
            end = part.rfind(b"\n") + 1
            if end == 0 and len(rest) + len(part) > MAX_LINE_BYTES:
                end = len(part)
            if end:
                yield b"".join((rest, memoryview(part)[:end]))
                rest = b""
            rest += part[end:]
        if rest:
            yield rest

    def _parts(self) -> Iterator[bytes]:
        for start in range(0, len(self.head), self._block_bytes):
            yield self.head[start : start + self._block_bytes]
        while part := self._source.read(self._block_bytes):
            yield self._plain(part)


class _Utf16:
    def __init__(self, encoding: str) -> None:
        import codecs

        self._decoder = codecs.getincrementaldecoder(encoding)(errors="replace")

    def decode(self, raw: bytes) -> str:
        return self._decoder.decode(raw).lstrip("\ufeff")


def _utf16(raw: bytes) -> _Utf16 | None:
    if raw[:2] == b"\xff\xfe" or (raw[1:2] == b"\0" and raw[3:4] == b"\0"):
        return _Utf16("utf-16-le")
    if raw[:2] == b"\xfe\xff":
        return _Utf16("utf-16-be")
    return None
