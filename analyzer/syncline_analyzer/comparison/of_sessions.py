"""Comparing what a Python user has at hand: sessions, analyses or files."""

from os import PathLike

from syncline_analyzer.comparison.rows import Comparison
from syncline_analyzer.comparison.whole import compare as compared
from syncline_analyzer.results import Analysis
from syncline_analyzer.session import Session, open_session

Comparable = Session | Analysis | str | PathLike[str]


def compare(golden: Comparable, capture: Comparable) -> Comparison:
    """What is different in a capture from a healthy one of the same machine, ranked.

    `compare("healthy.mcap", "today.mcap").to_frame()` is a table. Each side is a session, the
    analysis of one, or the path of a capture that needs no further options.

    Raises:
        CaptureError: a file is no capture that can be read.
    """
    return compared(_analysis(golden), _analysis(capture))


def _analysis(side: Comparable) -> Analysis:
    if isinstance(side, Analysis):
        return side
    return (side if isinstance(side, Session) else open_session(side)).analysis
