"""The exact worst cases against a sorted list of all values."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer.folds.timing.extremes import KEPT, Extremes


@given(st.lists(st.integers(0, 20), max_size=200), st.integers(1, 50))
@settings(max_examples=200, deadline=None)
def test_both_ends_are_those_of_the_sorted_values(values: list[int], size: int) -> None:
    """Of equal values the earliest are kept, whatever the blocks are."""
    made = Extremes()
    for at in range(0, len(values), size):
        part = np.array(values[at : at + size], np.int64)
        seq = np.arange(at, at + len(part))
        made.add(part * 1000, seq, seq * 7)
    numbered = list(enumerate(values))
    longest = sorted(numbered, key=lambda pair: (-pair[1], pair[0]))[:KEPT]
    shortest = sorted(numbered, key=lambda pair: (pair[1], pair[0]))[:KEPT]
    rows = made.rows("can0", 0x80, None, "sync period")
    got = {
        end: [(row.seq, row.value_us) for row in rows if row.extreme == end]
        for end in ("longest", "shortest")
    }
    assert got == {"longest": longest, "shortest": shortest}
    assert all(row.t_ns == 7 * row.seq for row in rows)


def test_responses_have_one_end() -> None:
    made = Extremes(both=False)
    made.add(np.array([5, 6]), np.array([1, 2]), np.array([1, 2]))
    assert {row.extreme for row in made.rows("can0", 0x181, 1, "response")} == {"longest"}
