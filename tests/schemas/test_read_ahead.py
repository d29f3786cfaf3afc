"""Working ahead in threads: order, errors, and what is left behind."""

import threading
from collections.abc import Iterator

import pytest

from syncline_schemas.capture.read_ahead import AHEAD, read_ahead


def threads() -> list[str]:
    return [each.name for each in threading.enumerate() if "read-ahead" in each.name]


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_results_come_in_the_order_of_the_items(workers: int) -> None:
    late = threading.Event()

    def work(item: int) -> int:
        if item == 1 and workers > 1:
            late.wait(5)
        if item == 2:
            late.set()
        return item * item

    assert list(read_ahead(range(50), work, workers)) == [n * n for n in range(50)]


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_is_raised_where_its_result_is_due(workers: int) -> None:
    def work(item: int) -> float:
        return 1 / (item - 3)

    results = read_ahead(range(9), work, workers)
    assert [next(results) for _ in range(3)] == [1 / -3, 1 / -2, 1 / -1]
    with pytest.raises(ZeroDivisionError):
        next(results)
    assert threads() == []


def test_an_error_of_the_items_is_raised_and_leaves_no_thread() -> None:
    def items() -> Iterator[int]:
        yield from range(3)
        raise OSError("the disk is gone")

    with pytest.raises(OSError, match="disk"):
        list(read_ahead(items(), str, 2))
    assert threads() == []


def test_closing_early_leaves_no_thread() -> None:
    results = read_ahead(range(10**9), str, 2)
    assert [next(results), next(results)] == ["0", "1"]
    assert threads()
    results.close()  # type: ignore[attr-defined]
    assert threads() == []


def test_the_first_result_takes_no_thread_and_no_further_item() -> None:
    taken = []

    def items() -> Iterator[int]:
        for item in range(100):
            taken.append(item)
            yield item

    results = read_ahead(items(), str, 2)
    next(results)
    assert (taken, threads()) == ([0], [])
    next(results)
    assert len(taken) <= AHEAD + 3
    results.close()  # type: ignore[attr-defined]
