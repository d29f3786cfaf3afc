"""CRC-32 as MCAP has it: by libdeflate where that is installed, many times as fast as by zlib."""

try:
    from deflate import crc32
except ImportError:
    from zlib import crc32  # type: ignore[assignment, unused-ignore]

__all__ = ["crc32"]
