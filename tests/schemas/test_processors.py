"""How many processors there are to work with."""

import pytest

from syncline_schemas import processors


def test_some_are_left_to_another_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processors, "_usable", lambda: 3)
    monkeypatch.setattr(processors, "_taken", 0)
    found = [processors.processors()]
    for count in (1, 2, 3):
        processors.leave(count)
        found.append(processors.processors())
    assert found == [3, 2, 1, 1]
