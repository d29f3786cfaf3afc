"""Waits and delays in words."""

import json
from dataclasses import replace

from syncline_analyzer.results import Ahead, Analysis, DelayRow, WaitRow
from syncline_analyzer.views.json_view import to_json
from syncline_analyzer.views.tables import table
from syncline_analyzer.views.waits import waiting_listings
from syncline_analyzer.views.words import Clock
from tests.analyzer.analysis_builder import analysis, at

AHEAD = [
    Ahead(0x381, 1, "TPDO3", 4, 1016.0, [91, 92, 93, 94]),
    Ahead(0x605, None, "SDO request", 1, 254.0, [95]),
]
WAIT = WaitRow("can0", 0x485, 5, "TPDO4", 99, at(1.25), 82, 4434.0, 146.0, 4188.0, 4042.0, AHEAD)
DELAY = DelayRow("can0", None, 1, "all", 112, 7, 28_280.0, 4040.0, 0x485, 99)


def rows(found: Analysis) -> list[list[list[str]]]:
    return [each.rows for each in waiting_listings(found, Clock.of(found.capture))]


def test_the_longest_wait_of_each_pdo_names_what_went_ahead() -> None:
    short = replace(WAIT, waiting_us=100.0, seq=5)
    other = replace(WAIT, cob_id=0x486, node=6, waiting_us=9000.0, ahead=AHEAD[:1])
    free = replace(WAIT, cob_id=0x187, waiting_us=0.0, ahead=[])
    ((first, second),) = rows(analysis(waits=[short, WAIT, other, free]))
    assert first[2] == "TPDO4 of node 6 (486h)"
    assert second[1:] == [
        "can0",
        "TPDO4 of node 5 (485h)",
        "4.434 ms",
        "0.146 to 4.188 ms",
        "4.042 ms",
        "381h x4 (TPDO3 of node 1), 605h (SDO request)",
    ]


def test_senders_are_listed_with_what_they_cost_others() -> None:
    by_id = replace(DELAY, cob_id=0x381, service="TPDO3")
    master = replace(DELAY, node=None, us=1000.0)
    ((node, nobody),) = rows(analysis(delays=[DELAY, master, by_id]))
    assert node == ["can0", "node 1", "7", "112", "28.28 ms", "4.04 ms", "485h"]
    assert nobody[1] == "master"


def test_tables_and_json_hold_what_went_ahead() -> None:
    found = analysis(waits=[WAIT], delays=[DELAY])
    (told,) = json.loads(to_json(found))["waits"]
    assert told["ahead"][1] == {
        "cob_id": 0x605,
        "node": None,
        "service": "SDO request",
        "frames": 1,
        "us": 254.0,
        "seq": [95],
    }
    frame = table(found, "waits")
    assert json.loads(frame["ahead"][0]) == told["ahead"]
    assert table(found, "delays")["worst_seq"].tolist() == [99]
    assert table(found, "lateness").empty


def test_nothing_is_listed_where_nothing_waited() -> None:
    assert rows(analysis()) == []
