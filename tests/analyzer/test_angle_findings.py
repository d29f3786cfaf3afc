"""Each rule on angles: what triggers it, and what comes near and must not."""

from typing import Any

from syncline_analyzer.findings.angle.rules import RULES
from syncline_analyzer.findings.angle.words import MAX_FINDINGS
from syncline_analyzer.results import TRACE_FLAGS, Finding, TraceEventRow, TraceRow
from tests.analyzer.analysis_builder import at
from tests.analyzer.rule_facts import judge
from tests.analyzer.test_timing_findings import analysis

FAST = "20 ms apart, which would take 9000 rpm; the device turns at most 3000 rpm"


def trace_row(unit: str = "counts", **flags: int) -> TraceRow:
    counts = dict.fromkeys(TRACE_FLAGS, 0) | flags
    return TraceRow("can0", 20, 0x600400, "Position value", unit, 500, 0.0, 131071.0, 0, counts)


def event(kind: str = "jump", seconds: float = 10.0, **changes: Any) -> TraceEventRow:
    plain: dict[str, Any] = {
        "bus": "can0",
        "node": 20,
        "object": 0x600400,
        "kind": kind,
        "seq": 7,
        "t_ns": at(seconds),
        "before": 5000.0,
        "after": 90_000.0,
        "text": FAST,
    }
    return TraceEventRow(**plain | changes)


def found(*events: TraceEventRow, **trace: Any) -> list[Finding]:
    return judge(RULES, analysis(traces=[trace_row(**trace)], trace_events=list(events)))


def test_a_jump_is_the_encoders_fault() -> None:
    (finding,) = found(event())
    assert (finding.id, finding.severity, finding.node) == ("angle.jump", "error", 20)
    assert (finding.start_ns, finding.evidence) == (at(10), [7])
    assert "from 5000 to 90000 counts at +10.000 s without a command" in finding.text
    assert FAST in finding.text
    assert "scale is assumed" not in finding.text


def test_a_jump_onto_the_preset_value_is_the_wires_doing() -> None:
    (finding,) = found(event(after=0.0, text=f"{FAST}; it landed at the preset value 0"))
    assert finding.severity == "warning"
    assert "set input" in finding.cause


def test_a_jump_on_an_assumed_scale_says_so() -> None:
    (finding,) = found(event(), scale_assumed=500)
    assert finding.text.endswith("The scale is assumed in part.")


def test_jumps_near_one_another_are_one_finding_far_ones_are_not() -> None:
    assert len(found(event(), event(seconds=12))) == 1
    assert len(found(event(), event(seconds=40))) == 2
    assert len(found(*(event(seconds=40 * k) for k in range(MAX_FINDINGS + 5)))) == 1


def test_a_cut_is_no_jump() -> None:
    assert found(event("cut", text="preset (6003h written)", before=None, after=None)) == []


def test_an_impossible_angle_is_the_scales_fault_where_it_was_assumed() -> None:
    impossible = event("out of range", before=None, after=-237.0, text="assumed: res")
    (finding,) = found(impossible, unit="deg", out_of_range=30, scale_assumed=500)
    assert (finding.id, finding.severity) == ("angle.out_of_range", "warning")
    assert "30 of 500" in finding.text
    assert "-237 deg" in finding.text
    assert "6000h (resolution) or 2040h (quadrant)" in finding.cause
    assert finding.cause.startswith("The scale that was assumed is wrong")


def test_an_impossible_angle_on_a_read_scale_is_not_called_assumed() -> None:
    impossible = event("out of range", before=None, after=-237.0, text="scale as read")
    (finding,) = found(impossible, unit="deg", out_of_range=30)
    assert "assumed" not in finding.cause


def test_wraps_and_ambiguous_samples_are_no_finding() -> None:
    assert found(wrap=40, ambiguous=500, scale_assumed=500) == []
