"""Work on what comes next in threads, while what came before is still being used."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, TypeVar

from syncline_schemas.processors import processors

if TYPE_CHECKING:
    from concurrent.futures import Future

MOST_WORKERS = 2
"""Threads that unpack: with two, unpacking is never slower than what uses it."""
AHEAD = 4
"""Items worked on before they are wanted."""

_T = TypeVar("_T")
_R = TypeVar("_R")


def default_workers() -> int:
    """Threads to work ahead with; 1 where there is one processor: then it is done in between."""
    return min(processors(), MOST_WORKERS)


def read_ahead(
    items: Iterable[_T], work: Callable[[_T], _R], workers: int | None = None
) -> Iterator[_R]:
    """The results of `work` on each item, in the order of the items.

    `items` is gone through by the caller's thread. The first result is made without any thread, as
    of many files only the beginning is looked at. What `work` raises, is raised where its result is
    due. No thread is left when the iterator is exhausted or closed.

    Args:
        items: may be endless.
        work: is called in several threads at once.
        workers: threads; with 1 or fewer everything is done in the caller's.
    """
    waiting_items = iter(items)
    for item in waiting_items:
        yield work(item)
        break
    workers = default_workers() if workers is None else workers
    if workers < 2:
        yield from map(work, waiting_items)
        return
    from concurrent.futures import ThreadPoolExecutor

    waiting: deque[Future[_R]] = deque()
    with ThreadPoolExecutor(workers, thread_name_prefix="syncline-read-ahead") as pool:
        try:
            for item in waiting_items:
                waiting.append(pool.submit(work, item))
                if len(waiting) > AHEAD:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for each in waiting:
                each.cancel()
