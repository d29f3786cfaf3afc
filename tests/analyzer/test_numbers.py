"""Small helpers for numbers, against Python's own."""

import statistics

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from syncline_analyzer.distinct import distinct
from syncline_analyzer.median import median

NUMBERS = st.lists(st.integers(-(2**63), 2**63 - 1) | st.integers(0, 3))


@given(numbers=NUMBERS)
def test_distinct_numbers_are_those_of_a_set(numbers: list[int]) -> None:
    assert distinct(np.array(numbers, np.int64)) == sorted(set(numbers))


@given(numbers=NUMBERS.filter(bool))
def test_the_median_is_that_of_the_standard_library(numbers: list[int]) -> None:
    assert median(iter(numbers)) == statistics.median(numbers)
