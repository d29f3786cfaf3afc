"""Reading captures, reconstructing what happened, and showing it.

Nothing heavy is imported here, so that a base install can say which extra is missing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from syncline_analyzer.comparison.of_sessions import compare as compare
    from syncline_analyzer.session import Session as Session
    from syncline_analyzer.session import open_session as open_session

__all__ = ["Session", "compare", "open_session"]

_MODULES = {"compare": "syncline_analyzer.comparison.of_sessions"}
"""Where a name comes from, unless it is of the session."""


def __getattr__(name: str) -> Any:
    if name in __all__:
        module = _MODULES.get(name, "syncline_analyzer.session")
        return getattr(import_module(module), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
