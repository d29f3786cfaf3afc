"""python-can as `can`, without the library that only its MDF 4 files need.

Where asammdf is installed, python-can imports it with everything behind it: seconds in which the
recorder does not listen yet and Ctrl-C is swallowed. Nothing here reads or writes MDF 4 by it.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def _hidden(name: str) -> Iterator[None]:
    """Make a module look as if it were not installed, unless it is loaded already."""
    if name in sys.modules:
        yield
        return
    sys.modules[name] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules[name]


with _hidden("asammdf"):
    import can

__all__ = ["can"]
