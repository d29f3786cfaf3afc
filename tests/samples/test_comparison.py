from dataclasses import dataclass

from syncline_samples.comparison import compare
from syncline_samples.truth import ExpectedFinding


@dataclass(frozen=True)
class Report:
    id: str = "nmt.node_lost"
    node: int | None = 3
    start_ns: int = 100
    end_ns: int = 120
    text: str = ""
    chain: "tuple[Report, ...]" = ()


def expected(
    finding: str = "nmt.node_lost", node: int | None = 3, *, required: bool = True
) -> ExpectedFinding:
    return ExpectedFinding(finding, node, 100, 90, 150, required, "cable loose")


def test_a_report_that_fits_is_found() -> None:
    outcome = compare([expected()], [Report()])
    assert outcome.agrees
    assert [reports for _, reports in outcome.found] == [[Report()]]


def test_another_node_another_time_another_id_do_not_fit() -> None:
    for report in (
        Report(node=4),
        Report(start_ns=150, end_ns=160),
        Report(start_ns=10, end_ns=20),
        Report(id="pdo.missed"),
    ):
        outcome = compare([expected()], [report])
        assert outcome.missing == [expected()]
        assert outcome.unexpected == [report]
        assert not outcome.agrees


def test_an_allowed_report_is_neither_found_nor_unexpected() -> None:
    outcome = compare([expected(required=False)], [Report()])
    assert outcome.agrees
    assert outcome.allowed == [Report()]
    assert compare([expected(required=False)], []).agrees


def test_an_event_may_be_told_under_another_name() -> None:
    entry = expected()._replace(or_as=("nmt.unexpected_reset",))
    assert compare([entry], [Report(id="nmt.unexpected_reset")]).agrees


def test_equal_reports_are_counted_one_by_one() -> None:
    outcome = compare([], [Report(), Report()])
    assert len(outcome.unexpected) == 2


def test_a_piece_of_a_story_is_found_like_a_finding_of_its_own() -> None:
    story = Report(id="nmt.duplicate_node_id", chain=(Report(),))
    outcome = compare([expected(), expected("nmt.duplicate_node_id")], [story])
    assert outcome.agrees


def test_a_piece_of_a_story_can_be_unexpected() -> None:
    story = Report(chain=(Report(id="pdo.missed"),))
    assert [piece.id for piece in compare([expected()], [story]).unexpected] == ["pdo.missed"]
