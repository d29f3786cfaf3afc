"""A disk that refuses: full, read-only, broken; when it is tried again."""

import errno
from dataclasses import dataclass, replace
from typing import Self

FIRST_RETRY_NS = 1_000_000_000
LONGEST_RETRY_NS = 30_000_000_000

_TROUBLE = frozenset(
    {
        errno.ENOSPC,
        errno.EIO,
        errno.EROFS,
        errno.EFBIG,
        errno.ENODEV,
        errno.ENXIO,
        getattr(errno, "EDQUOT", errno.ENOSPC),
        getattr(errno, "ESTALE", errno.EIO),
        getattr(errno, "EUCLEAN", errno.EIO),
    }
)


def is_trouble(error: OSError) -> bool:
    """Whether an error is one of the disk, which may go away, and no mistake of the user's."""
    return error.errno in _TROUBLE


@dataclass(frozen=True, slots=True)
class DiskTrouble:
    """What the disk refuses.

    Attributes:
        text: in words.
        since_ns: of the first refusal, log time.
        retry_ns: when it is tried again.
        delay_ns: how long to wait after the next refusal.
    """

    text: str
    since_ns: int
    retry_ns: int
    delay_ns: int

    @classmethod
    def first(cls, error: OSError, now_ns: int) -> Self:
        """The first refusal."""
        return cls(words(error), now_ns, now_ns + FIRST_RETRY_NS, 2 * FIRST_RETRY_NS)

    def is_due(self, now_ns: int) -> bool:
        """Whether it is time to try again."""
        return now_ns >= self.retry_ns

    def again(self, error: OSError, now_ns: int) -> Self:
        """One more refusal; the waits grow up to half a minute."""
        delay_ns = min(2 * self.delay_ns, LONGEST_RETRY_NS)
        return replace(self, text=words(error), retry_ns=now_ns + self.delay_ns, delay_ns=delay_ns)

    def over(self, now_ns: int) -> str:
        """That it is over, in words."""
        return f"the disk can be written again after {(now_ns - self.since_ns) / 1e9:.0f} s"


def words(error: OSError) -> str:
    """The reason of a gap.

    >>> words(OSError(28, "No space left on device"))
    'the disk cannot be written: No space left on device'
    """
    return f"the disk cannot be written: {error.strerror or error}"
