"""Golden against capture: what is different from a healthy recording of the same machine."""

from syncline_analyzer.comparison.rows import Comparison as Comparison
from syncline_analyzer.comparison.rows import ComparisonRow as ComparisonRow
from syncline_analyzer.comparison.rows import UnseenRow as UnseenRow
from syncline_analyzer.comparison.whole import compare as compare

__all__ = ["Comparison", "ComparisonRow", "UnseenRow", "compare"]
