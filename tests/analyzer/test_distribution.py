"""Statistics in bounded memory against numpy on all values."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer.distribution import (
    EXACT_LIMIT,
    RELATIVE_ERROR,
    Distribution,
    median_of,
    quantile_of,
)
from syncline_analyzer.series import Thinner, extreme_rows


def distribution(values: np.ndarray, size: int = 1000) -> Distribution:
    made = Distribution()
    for at in range(0, len(values), size):
        made.add(values[at : at + size])
    return made


def samples(kind: str, count: int) -> np.ndarray:
    rng = np.random.default_rng(7)
    match kind:
        case "narrow":
            return rng.normal(20_000_000, 5_000, count).astype(np.int64)
        case "wide":
            return np.exp(rng.uniform(0, 25, count)).astype(np.int64)
        case "drifting":
            return np.linspace(1e5, 1e8, count).astype(np.int64)
        case _:
            return np.full(count, 1_000_000)


@pytest.mark.parametrize("kind", ["narrow", "wide", "drifting", "constant"])
@pytest.mark.parametrize("count", [1, 100, EXACT_LIMIT, 60_000])
def test_agrees_with_numpy(kind: str, count: int) -> None:
    values = samples(kind, count)
    made = distribution(values)
    assert made.count == count
    assert (made.minimum, made.maximum) == (values.min(), values.max())
    assert made.mean == pytest.approx(values.mean())
    assert made.std == pytest.approx(values.std(), rel=1e-6, abs=1e-3)
    for share in (0.01, 0.25, 0.5, 0.75, 0.99):
        got, truth = made.quantile(share), float(np.quantile(values, share))
        if count <= EXACT_LIMIT:
            assert got == truth
        else:
            assert got == pytest.approx(truth, rel=2 * RELATIVE_ERROR, abs=2)


def test_the_error_is_far_smaller_where_most_values_lie() -> None:
    values = samples("narrow", 100_000)
    made = distribution(values)
    for share in (0.01, 0.5, 0.99):
        assert abs(made.quantile(share) - np.quantile(values, share)) < 50


@given(
    st.lists(st.integers(0, 10**12), min_size=1, max_size=40),
    st.integers(EXACT_LIMIT + 1, 3 * EXACT_LIMIT),
    st.floats(0, 1),
    st.integers(0, 2**32),
)
@settings(max_examples=60, deadline=None)
def test_no_quantile_is_off_by_more_than_the_stated_error(
    levels: list[int], count: int, share: float, seed: int
) -> None:
    """Whatever the values are: clusters anywhere between 0 and a quarter of an hour, in any order."""
    rng = np.random.default_rng(seed)
    values = rng.choice(np.array(levels), count) + rng.integers(0, 1000, count)
    made = distribution(values, 5000)
    low, high = (
        np.quantile(values, share, method="lower"),
        np.quantile(values, share, method="higher"),
    )
    error = made.relative_error
    assert 0 < error <= 0.01
    assert low * (1 - error) - 1 <= made.quantile(share) <= high * (1 + error) + 1
    assert (made.minimum, made.maximum) == (values.min(), values.max())


def test_a_first_value_far_away_does_not_blur_the_deviation() -> None:
    values = np.random.default_rng(1).normal(10_000_000, 1000, 100_000).astype(np.int64)
    values[0] = 86_400_000_000_000
    assert distribution(values).std == pytest.approx(values.std(), rel=1e-9)
    calm = Distribution()
    calm.add(values[:1])
    calm.add(values[1:])
    assert calm.std == pytest.approx(values.std(), rel=1e-9)


@pytest.mark.usefixtures("both_ways")
@pytest.mark.parametrize("near", [2**53, 4 * 10**18])
def test_equal_values_of_many_years_have_bins(near: int) -> None:
    values = np.full(EXACT_LIMIT + 20_000, near)
    values[-1000:] = 0
    found = distribution(values)
    assert found.quantile(0.5) == pytest.approx(near, rel=RELATIVE_ERROR)
    assert found.quantile(0.0) == pytest.approx(0, abs=1)


@pytest.mark.parametrize("first", [0.0, 700.0, 1e6])
def test_many_equal_values_at_a_time(first: float) -> None:
    spread, parts = Distribution(), []
    for value in (first, 0.0, 300.0, 700.0, 0.0, 5e8):
        parts.append(np.full(EXACT_LIMIT + 1, value))
        spread.add(parts[-1])
    values = np.concatenate(parts)
    counts = spread.histogram()[0]
    assert counts.sum() == len(values)
    for share in (0.0, 0.4, 0.6, 0.75, 1.0):
        exact = float(np.quantile(values, share))
        assert spread.quantile(share) == pytest.approx(exact, rel=1.01 * RELATIVE_ERROR, abs=0.01)
    assert (spread.mean, spread.std) == pytest.approx((values.mean(), values.std()))


def test_spreads_that_the_stamps_cannot_show_are_left_out() -> None:
    made = distribution(np.array([10_000_000] * 98 + [10_600_000, 12_000_000]))
    quantiles = made.quantiles(1000, std=True)
    assert quantiles is not None
    assert (quantiles.min, quantiles.median, quantiles.max) == (10_000, 10_000, 12_000)
    assert quantiles.std is not None
    coarse, fine = made.jitter(1000, 1_000_000), made.jitter(1000, 1000)
    assert coarse is not None
    assert fine is not None
    assert (coarse.std, coarse.p99_p1, coarse.max_min) == (None, None, 2000)
    assert fine.std == pytest.approx(np.std([10_000] * 98 + [10_600, 12_000]))
    assert made.off(10_300_000, 1000, 1_000_000) is None
    assert made.off(10_300_000, 1000, 1000) == -300
    assert Distribution().jitter(1000, 1) is None


@pytest.mark.parametrize("count", [500, 60_000])
def test_jitter_of_the_values_below_a_limit(count: int) -> None:
    values = samples("narrow", count)
    values[count // 2 :: 97] *= 2
    kept = values[values < 30_000_000] / 1000
    made = distribution(values).jitter(1000, 1, below_ns=30_000_000)
    assert made is not None
    assert made.std == pytest.approx(kept.std(), rel=0.01)
    low, high = np.quantile(kept, (0.01, 0.99))
    assert made.p99_p1 == pytest.approx(high - low, rel=0.01)
    assert made.max_min == pytest.approx(np.ptp(kept), rel=0.01)
    assert distribution(values).jitter(1000, 1, below_ns=1000) is None


@pytest.mark.parametrize("count", [10, 50_000])
def test_the_histogram_holds_every_value(count: int) -> None:
    values = samples("narrow", count)
    values[-1] *= 40
    counts, edges = distribution(values).histogram()
    assert counts.sum() == count
    assert len(edges) == len(counts) + 1
    assert (np.diff(edges) > 0).all()
    assert edges[0] <= values.min()
    assert edges[-1] >= values.max()


@pytest.mark.parametrize("far", [30.0, 6_606_500_000.0])
def test_a_value_far_away_is_drawn_where_it_is(far: float) -> None:
    values = np.random.default_rng(4).normal(6_000_000, 100_000, 5000)
    counts, edges = distribution(np.append(values, far)).histogram()
    at = int(np.searchsorted(edges, far, side="right")) - 1
    assert counts[at] == 1
    assert edges[at + 1] - edges[at] <= max(0.1 * far, 20_000)


def test_nothing_added() -> None:
    made = Distribution()
    assert made.quantiles(1000) is None
    assert np.isnan(made.quantile(0.5))
    assert made.histogram()[0].tolist() == []


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=300), st.integers(2, 20))
@settings(max_examples=100, deadline=None)
def test_each_run_keeps_its_extremes(values: list[float], run: int) -> None:
    column = np.array(values)
    rows = extreme_rows(column, run)
    assert (np.diff(rows) > 0).all()
    for at in range(0, len(values), run):
        kept = rows[(rows >= at) & (rows < at + run)]
        assert len(kept) <= 2
        assert column[kept].min() == column[at : at + run].min()
        assert column[kept].max() == column[at : at + run].max()


def test_a_thinner_keeps_everything_up_to_its_limit_and_every_peak_beyond() -> None:
    thinner = Thinner("value", 1000)
    value = np.sin(np.arange(50_000) / 100)
    value[33_333], value[44_444] = 50.0, -60.0
    for at in range(0, 50_000, 500):
        part = np.arange(at, at + 500)
        thinner.add({"value": value[part], "row": part})
        if at == 500:
            assert thinner.stride == 1
            assert len(thinner.columns()["row"]) == 1000
    columns = thinner.columns()
    assert thinner.stride > 1
    assert len(columns["row"]) <= 1000
    assert {33_333, 44_444} <= set(columns["row"].tolist())
    assert (np.diff(columns["row"]) > 0).all()
    np.testing.assert_array_equal(value[columns["row"]], columns["value"])


def test_the_deviation_is_right_far_from_the_first_values() -> None:
    """A SYNC of 10 ms that is set to 10 s: the squares around the old period say nothing then."""
    rng = np.random.default_rng(3)
    first = rng.normal(1e7, 10, EXACT_LIMIT + 1).round()
    then = rng.normal(1e10, 10, 200 * EXACT_LIMIT).round()
    made = distribution(np.concatenate([first, then]), EXACT_LIMIT + 1)
    alone = Distribution()
    alone.add(first)
    alone.add(np.full(1, 1e10))
    assert made.std == pytest.approx(np.concatenate([first, then]).std(), rel=1e-12)
    assert alone.std == pytest.approx(np.append(first, 1e10).std(), rel=1e-12)


def test_a_column_that_some_blocks_lack_is_not_a_number_there() -> None:
    thinner = Thinner("value", 100)
    thinner.add({"value": np.arange(3.0)})
    thinner.add({"value": np.arange(2.0), "bound": np.array([7.0, 8.0])})
    columns = thinner.columns()
    assert columns["value"].tolist() == [0, 1, 2, 0, 1]
    assert np.isnan(columns["bound"][:3]).all()
    assert columns["bound"][3:].tolist() == [7, 8]


@given(st.lists(st.integers(0, 400), min_size=1, max_size=40), st.integers(0, 2**32))
@settings(max_examples=30, deadline=None)
def test_what_is_added_at_a_time_changes_nothing(cuts: list[int], seed: int) -> None:
    value = np.random.default_rng(seed).integers(0, 20, sum(cuts)).astype(np.float64)
    row = np.arange(len(value))
    whole, parts = Thinner("value", 48), Thinner("value", 48)
    whole.add({"value": value, "row": row})
    for part in np.split(row, np.cumsum(cuts)[:-1]):
        parts.add({"value": value[part], "row": part})
        assert parts.empty or len(parts.columns()["row"]) <= 48
    assert whole.stride == parts.stride
    assert whole.empty == (not len(value))
    if len(value):
        assert whole.columns()["row"].tolist() == parts.columns()["row"].tolist()


@given(
    values=st.lists(st.integers(-(2**52), 2**52), min_size=1)
    | st.lists(st.floats(0, 1e18), min_size=1),
    share=st.sampled_from([0.0, 0.01, 0.25, 0.5, 0.99, 1.0]),
)
def test_the_middle_of_values_is_what_numpy_tells(values: list[float], share: float) -> None:
    column = np.array(values)
    assert median_of(column) == np.median(column)
    assert quantile_of(column, share) == np.quantile(column, share)
