"""How often Python looks for reference cycles while an analysis runs."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

YOUNG = 100_000
"""Objects made until the next search; Python's usual 700 cost a fifth of the time of many rows."""


@contextmanager
def rare_collections() -> Iterator[None]:
    """Search seldom: an analysis makes hardly any cycles, and many rows that all live on."""
    before = gc.get_threshold()
    if before[0]:
        gc.set_threshold(max(YOUNG, before[0]), *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


@contextmanager
def settled_objects() -> Iterator[None]:
    """Leave what there is out of the searches: modules above all, a hundred thousand objects."""
    if gc.get_freeze_count():
        yield
        return
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
