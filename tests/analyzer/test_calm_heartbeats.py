"""Heartbeats that wait because they tell nothing new: what is told of a node stays the same."""

from collections.abc import Iterator

import numpy as np
import pytest

from syncline_analyzer.folds.nmt import calm
from syncline_analyzer.folds.nmt.error_control import ErrorControl
from syncline_schemas.batch import Gap
from tests.analyzer.control_runs import MS, Row, Run, frame, remote, run

NODES = (3, 9)


def life(seed: int, seconds: int) -> Iterator[Row | Gap]:
    """Two nodes with heartbeats and PDOs, and now and then whatever may break their calm."""
    rng = np.random.default_rng(seed)
    rows: list[Row] = []
    for node in NODES:
        beats = np.arange(0, seconds * 1000, 50) + rng.uniform(0, 2, seconds * 20)
        dead = rng.uniform(0, seconds * 1000, 4)
        for t_ms in beats.tolist():
            if any(0 < t_ms - begin < 400 for begin in dead):
                continue
            # A restart of the device, a state that it takes by itself, a message that is none.
            what = {0: "00", 1: "7F", 2: "0505", 3: ""}.get(int(rng.integers(0, 600)), "05")
            rows.append(frame(t_ms, 0x700 + node, what))
        for t_ms in np.arange(3, seconds * 1000, 20).tolist():
            rows.append(frame(t_ms + float(rng.uniform(0, 1)), 0x180 + node, "0102"))
        for t_ms in rng.uniform(0, seconds * 1000, 3).tolist():
            rows.append(remote(t_ms, 0x700 + node))
    for t_ms in rng.uniform(0, seconds * 1000, 6).tolist():
        command = rng.choice(["0100", "8003", "8109", "8200", "0109"])
        rows.append(frame(t_ms, 0x000, str(command)))
    rows.sort(key=lambda row: row[0])
    back = int(rng.integers(len(rows)))
    rows[back] = (rows[back][0] - 200 * MS, *rows[back][1:])
    cut = int(rng.integers(1, len(rows)))
    yield from rows[:cut]
    yield Gap(rows[cut - 1][0], rows[cut][0], "test", None, None)
    yield from rows[cut:]


def tables(found: Run) -> list[object]:
    """All that is told of the nodes."""
    analysis = found.analysis
    return [analysis.nmt_states, analysis.nmt_commands, analysis.nodes, found.findings()]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("size", [40, 400])
def test_calm_changes_nothing(seed: int, size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    items = [*life(seed, 60)]
    monkeypatch.setattr(calm, "ENOUGH", 100)
    waited = 0
    go_on = ErrorControl.go_on

    def counting(self: ErrorControl, *args: object) -> None:
        nonlocal waited
        waited += 1
        go_on(self, *args)  # type: ignore[arg-type]

    monkeypatch.setattr(ErrorControl, "go_on", counting)
    waiting = tables(run(*items, batch=size))
    assert waited, "some batches hold nothing but heartbeats that go on"
    monkeypatch.setattr(ErrorControl, "steady", None)
    assert tables(run(*items, batch=size)) == waiting
