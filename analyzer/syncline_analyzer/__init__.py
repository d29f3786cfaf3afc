"""Reading captures, reconstructing what happened, and showing it.

Nothing heavy is imported here, so that a base install can say which extra is missing.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from syncline_analyzer.session import Session as Session
    from syncline_analyzer.session import open_session as open_session

__all__ = ["Session", "open_session"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        from syncline_analyzer import session

        return getattr(session, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
