"""What a user can do wrong, as one family of errors.

    SynclineError
    ├── UsageError            an option or argument makes no sense          (also ValueError)
    │   └── SeveralErrors     several things are wrong at once
    ├── CaptureError          a file is no capture that can be read         (also OSError)
    ├── DescriptionError      a bus description, EDS or device is unusable   (also ValueError)
    ├── SourceError           a bus interface cannot be opened or read       (also OSError)
    └── MissingExtraError     a package of an optional extra is missing      (also ImportError)

Bytes from a bus or a file never raise: they become values, findings or counted losses.
Every message says what was wrong, where, and what to do.
"""

from collections.abc import Sequence


class SynclineError(Exception):
    """Root of all errors that a user can cause; the command line prints it as one line."""

    exit_code = 2


class UsageError(SynclineError, ValueError):
    """An option or argument makes no sense."""


class SeveralErrors(UsageError):
    """Several things are wrong; `problems` holds a line for each."""

    def __init__(self, problems: Sequence[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = tuple(problems)


class CaptureError(SynclineError, OSError):
    """A file is no capture that can be read."""


class DescriptionError(SynclineError, ValueError):
    """A bus description, EDS file or device name is unusable."""


class SourceError(SynclineError, OSError):
    """A bus interface cannot be opened or read."""


class MissingExtraError(SynclineError, ImportError):
    """A package of an optional extra is missing."""
