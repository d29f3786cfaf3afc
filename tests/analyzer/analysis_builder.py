"""Analyses to show: builders with keyword defaults, and a bad day that uses every table."""

from dataclasses import fields, replace
from typing import Any

import numpy as np

from syncline_analyzer.results import (
    TRACE_FLAGS,
    Analysis,
    BusErrorRow,
    BusLoadRow,
    BusStateRow,
    CaptureRow,
    DeviceHealthRow,
    EmcyContextRow,
    EmcyRow,
    ErrorHistoryRow,
    ErrorRow,
    Finding,
    FollowerRow,
    GapRow,
    LssRow,
    NmtCommandRow,
    NmtStateRow,
    NodeRow,
    ObjectChangeRow,
    ObjectRow,
    PdoRow,
    Quantiles,
    Responses,
    SdoRow,
    SdoTransfers,
    Series,
    ShaftRow,
    SyncRow,
    TiltRow,
    TiltSetting,
    TiltTrace,
    TimeStampRow,
    Trace,
    TraceEventRow,
    TraceRow,
)
from syncline_schemas.tilt import Angles, gravity_of

T0 = 1_790_000_000_000_000_000
SECOND = 1_000_000_000
MINUTES_10 = 600 * SECOND


def at(seconds: float) -> int:
    """A stamp so many seconds after the first frame."""
    return T0 + round(seconds * SECOND)


def capture_row(**changes: Any) -> CaptureRow:
    plain: dict[str, Any] = {
        "files": ["bad_day.mcap"],
        "frames": 412_345,
        "data_frames": 411_000,
        "remote_frames": 1_340,
        "error_frames": 5,
        "extended_frames": 0,
        "unparsed_lines": 0,
        "start_utc_ns": T0,
        "duration_ns": MINUTES_10,
        "buses": ["can0"],
        "gaps": [],
        "first_ns": T0,
    }
    return CaptureRow(**plain | changes)


def node_row(node: int = 10, **changes: Any) -> NodeRow:
    plain: dict[str, Any] = {
        "bus": "can0",
        "node": node,
        "name": None,
        "device": None,
        "boot_ups": 1,
        "heartbeats": 6000,
        "heartbeat_period_ms": 100.0,
        "guard_requests": 0,
        "guard_answers": 0,
        "toggle_errors": 0,
        "emcy": 0,
        "sdo_transfers": 4,
        "sdo_aborts": 0,
        "sdo_unanswered": 0,
        "pdo_frames": 60_000,
        "state_share": {"PRE-OPERATIONAL": 0.01, "OPERATIONAL": 0.99},
        "final_state": "OPERATIONAL",
        "proof": ["error control", "pdo"],
    }
    return NodeRow(**plain | changes)


def state_rows(
    node: int, *changes: tuple[float, str, str], bus: str = "can0", end: float = 600.0
) -> list[NmtStateRow]:
    """Intervals of one node from (second, state, cause) up to `end`."""
    ends = [*(second for second, _, _ in changes[1:]), end]
    return [
        NmtStateRow(bus, node, state, at(start), at(stop), cause, "observed", round(start * 700))
        for (start, state, cause), stop in zip(changes, ends, strict=True)
    ]


def usual_states(node: int, start: float = 0.4, bus: str = "can0") -> list[NmtStateRow]:
    return state_rows(
        node,
        (0.0, "UNKNOWN", "start of capture"),
        (start, "PRE-OPERATIONAL", "boot-up"),
        (start + 2.0, "OPERATIONAL", "heartbeat"),
        bus=bus,
    )


def pdo_row(cob_id: int = 0x18A, node: int | None = 10, **changes: Any) -> PdoRow:
    plain: dict[str, Any] = {
        "bus": "can0",
        "cob_id": cob_id,
        "node": node,
        "pdo": "TPDO1",
        "frames": 59_840,
        "transmission_type": 1,
        "type_source": "sdo-read",
        "period_us": Quantiles(9_812.0, 10_000.0, 10_140.0, 20_011.0),
        "response_us": Quantiles(402.0, 655.0, 902.0, 1_480.0, 71.5),
        "device_us_low": Quantiles(120.0, 310.0, 520.0, 900.0),
        "device_us_high": Quantiles(250.0, 450.0, 700.0, 1_290.0),
        "missed": 0,
        "extra": 0,
        "late": 0,
    }
    return PdoRow(**plain | changes)


def emcy_row(
    node: int = 10, second: float = 250.0, code: int | None = 0x8130, **changes: Any
) -> EmcyRow:
    plain: dict[str, Any] = {
        "bus": "can0",
        "node": node,
        "seq": round(second * 700),
        "t_ns": at(second),
        "code": code,
        "meaning": "life guard error or heartbeat error",
        "error_register": 0x11,
        "registers": ["generic", "communication"],
        "manufacturer_hex": "00 00 00 00 00",
        "transition": "raised",
    }
    return EmcyRow(**plain | changes)


def sdo_row(node: int = 10, second: float = 1.0, **changes: Any) -> SdoRow:
    plain: dict[str, Any] = {
        "bus": "can0",
        "node": node,
        "seq": round(second * 700),
        "start_ns": at(second),
        "end_ns": at(second + 0.001),
        "index": 0x1017,
        "sub": 0,
        "direction": "download",
        "kind": "expedited",
        "size": 2,
        "value": 100,
        "result": "ok",
        "abort_code": None,
        "answer_us": 850.0,
        "name": "Producer heartbeat time",
        "data": b"\x64\x00",
    }
    return SdoRow(**plain | changes)


def finding(id: str = "nmt.node_lost", second: float = 250.0, **changes: Any) -> Finding:
    plain: dict[str, Any] = {
        "id": id,
        "severity": "error",
        "bus": "can0",
        "node": 10,
        "start_ns": at(second),
        "end_ns": at(second + 31),
        "text": "Node 10 went silent for 31 s while the rest of the bus kept running.",
        "cause": "Supply or wiring of node 10 interrupted.",
        "check_next": "Connector and supply at node 10; compare with the EMCY 3100h before it.",
        "evidence": [round(second * 700), round((second + 31) * 700)],
    }
    return Finding(**plain | changes)


def analysis(**changes: Any) -> Analysis:
    """An analysis in which everything is empty that is not given."""
    plain: dict[str, Any] = {f.name: [] for f in fields(Analysis)}
    given = plain | {"capture": capture_row()} | changes
    return Analysis(**given | {"sdo": SdoTransfers.of(given["sdo"])})


def shaft(count: int = 60_000, node: int = 5, name: str = "Position value") -> Trace:
    """An encoder that swings, turns over and is cut once."""
    t_ns = np.linspace(at(3), at(600), count).astype(np.int64)
    unwrapped = 170 * np.sin((t_ns - T0) / 30e9) + 200
    unwrapped[round(count * 0.7)] += 90.0
    angle = unwrapped % 360
    flags = np.zeros(count, np.uint16)
    flags[round(count * 0.7)] = 1 << TRACE_FLAGS.index("jump")
    flags[1:][np.abs(np.diff(angle)) > 180] |= 1 << TRACE_FLAGS.index("wrap")
    position = (angle / 360 * 8192).astype(np.int64)
    segment = (t_ns > at(265)).astype(np.int32)
    columns = {
        "position": position.astype(np.float64),
        "turn": np.zeros(count),
        "angle_deg": angle,
        "unwrapped_deg": unwrapped,
        "speed_rpm": np.gradient(unwrapped) / np.gradient(t_ns) * 1e9 / 6,
    }
    return Trace(
        "can0", node, 0x600400, name, "counts", t_ns, np.arange(count, dtype=np.int64) * 6 + 40,
        position, position.astype(np.float64), flags, segment, columns,
    )  # fmt: skip


def tilt(object: int, name: str, period_s: float, count: int = 6_000, node: int = 10) -> Trace:
    """An inclinometer axis that is silent while the node is lost."""
    t_ns = np.linspace(at(3), at(600), count).astype(np.int64)
    keep = (t_ns < at(250)) | (t_ns > at(283))
    t_ns = t_ns[keep]
    value = 20 * np.sin((t_ns - T0) / (period_s * 1e9))
    return Trace(
        "can0", node, object, name, "deg", t_ns, np.arange(len(t_ns), dtype=np.int64) * 60,
        (value * 100).astype(np.int64), value, np.zeros(len(t_ns), np.uint16),
        (t_ns > at(260)).astype(np.int32),
    )  # fmt: skip


def tilt_of(first: Trace, second: Trace, angles: Angles | None = Angles.GIMBAL_X) -> TiltTrace:
    """Both axes of an inclinometer together; without `angles` they are no pose."""
    gravity = np.full((len(first.t_ns), 3), np.nan)
    if angles:
        gravity = gravity_of(angles, first.value, second.value).gravity
    setting = TiltSetting(angles or "perpendicular", angles or "", "absolute", "")
    return TiltTrace(
        first.bus, first.node, first.object, first.t_ns, first.seq, first.value, second.value,
        gravity, np.zeros(len(gravity), np.uint8), np.zeros(len(gravity), np.int64), [setting],
    )  # fmt: skip


def trace_row(trace: Trace) -> TraceRow:
    flags = {name: int((trace.flags >> bit & 1).sum()) for bit, name in enumerate(TRACE_FLAGS)}
    return TraceRow(
        trace.bus, trace.node, trace.object, trace.name, trace.unit, len(trace.t_ns),
        float(trace.value.min()), float(trace.value.max()), int(np.ptp(trace.segment)), flags,
    )  # fmt: skip


def responses(cob_id: int = 0x18A, node: int = 10, count: int = 20_000, seed: int = 1) -> Responses:
    random = np.random.default_rng(seed)
    t_ns = np.linspace(at(3), at(600), count).astype(np.int64)
    response = 655 + random.normal(0, 70, count) + 200 * (random.random(count) < 0.02)
    counts, edges = np.histogram(response, bins=80)
    return Responses(
        "can0", cob_id, node, "TPDO1", np.arange(count, dtype=np.int64) * 20, t_ns, response,
        response - 340, response - 200, counts.astype(np.int64), edges,
        response - 340, np.full(count, 100.0),
    )  # fmt: skip


def series(
    name: str, unit: str, value: np.ndarray[Any, np.dtype[np.float64]], bus: str = "can0"
) -> Series:
    t_ns = np.linspace(at(0), at(600), len(value)).astype(np.int64)
    return Series(bus, name, unit, t_ns, value)


def bad_day(**changes: Any) -> Analysis:
    """Ten minutes of six devices: a supply dip, a lost node, a gap, a jump and late answers."""
    random = np.random.default_rng(7)
    traces = [
        shaft(),
        tilt(0x601000, "Slope long", 40.0),
        tilt(0x602000, "Slope lateral", 55.0),
    ]
    load = 31 + 4 * random.random(600)
    load[250:281] = 22 + 2 * random.random(31)
    period = 10_000 + random.normal(0, 12, 5_000)
    period[3_500] = 19_987.0
    rows: dict[str, Any] = {
        "capture": capture_row(gaps=[GapRow(at(420), at(421.5), "adapter lost", None, "can0")]),
        "nodes": _bad_day_nodes(),
        "nmt_commands": [
            NmtCommandRow("can0", 300, at(2.4), "start", 0, 12.3),
            NmtCommandRow("can0", 198_000, at(282.9), "start", 10, 31.0),
            NmtCommandRow("can0", 300_000, at(430.0), "stop", 16, None),
        ],
        "nmt_states": _bad_day_states(),
        "sync": [SyncRow("can0", 0x80, 59_990, Quantiles(9_812, 10_000, 10_031, 19_987), 1, 0)],
        "pdos": [
            pdo_row(0x185, 5, missed=0),
            pdo_row(missed=3, missed_seq=[210_004, 210_011, 210_018], late=2),
            pdo_row(0x28A, 10, pdo="TPDO2", transmission_type=None, type_source="unknown",
                    response_us=None, device_us_low=None, device_us_high=None, frames=120),
            pdo_row(0x1FF, None, pdo=None, transmission_type=None, type_source="unknown",
                    response_us=None, device_us_low=None, device_us_high=None, frames=7,
                    period_us=None),
        ],
        "emcy": _bad_day_emcy(),
        "errors": [
            ErrorRow("can0", 10, 0x3100, "mains voltage", at(249.9), None, "lost at reset", 1, [174_930]),
            ErrorRow("can0", 10, 0x8130, "life guard error or heartbeat error", at(281.2), at(284.0), "cleared", 1, [196_840, 198_800]),
            ErrorRow("can0", 16, 0x8110, "CAN overrun (objects lost)", at(520.0), None, "still active", 3, [364_000]),
        ],
        "sdo": [
            sdo_row(),
            sdo_row(second=1.2, index=0x1008, direction="upload", kind="segmented", size=6, value="JN2100",
                    name="Manufacturer device name", data=b"JN2100"),
            sdo_row(node=16, second=1.4, index=0x6002, direction="upload", value=None, result="abort",
                    abort_code=0x06020000, name="Total measuring range", data=b""),
            sdo_row(node=16, second=300.0, direction="upload", value=None, result="no answer", size=None,
                    answer_us=None, data=b""),
        ],
        "traces": [trace_row(trace) for trace in traces],
        "bus_load": [BusLoadRow("can0", 500_000, 33.1, 61.7, 687.2)],
        "findings": _bad_day_findings(),
        "trace_data": traces,
        "tilt_data": [tilt_of(traces[1], traces[2])],
        "responses": [responses(), responses(0x185, 5, seed=2)],
        "series": [series("bus load", "%", load), series("SYNC 080h period", "us", period)],
    }  # fmt: skip
    return analysis(**rows | changes)


def _bad_day_nodes() -> list[NodeRow]:
    return [
        node_row(1, name="master", pdo_frames=0, proof=["error control"]),
        node_row(5, name="shaft", device="lir-da158a"),
        node_row(7, name="gate", device="lir-ma158k", guard_requests=600, guard_answers=600,
                 heartbeats=0, heartbeat_period_ms=None),
        node_row(10, name="boom tilt", device="jn2100", boot_ups=2, emcy=4, sdo_transfers=6,
                 state_share={"OPERATIONAL": 0.94, "LOST": 0.052, "PRE-OPERATIONAL": 0.008}),
        node_row(16, name="winch", device="haomiao-38", emcy=3, sdo_aborts=1, sdo_unanswered=1,
                 state_share={"OPERATIONAL": 0.71, "STOPPED": 0.29}, final_state="STOPPED"),
        node_row(33, heartbeats=0, heartbeat_period_ms=None, proof=["pdo (guess)"],
                 state_share={"UNKNOWN": 1.0}, final_state="UNKNOWN"),
    ]  # fmt: skip


def _bad_day_states() -> list[NmtStateRow]:
    states = [row for node in (1, 5, 7) for row in usual_states(node)]
    states += state_rows(
        10,
        (0.0, "UNKNOWN", "start of capture"),
        (0.6, "PRE-OPERATIONAL", "boot-up"),
        (2.4, "OPERATIONAL", "heartbeat"),
        (250.0, "LOST", "silent longer than 150 ms"),
        (281.0, "INITIALISING", "last sign of life before the boot-up"),
        (281.1, "PRE-OPERATIONAL", "boot-up"),
        (282.9, "OPERATIONAL", "heartbeat"),
        (500.0, "LOST", "silent longer than 150 ms"),
        (500.002, "OPERATIONAL", "heartbeat"),
    )
    states += state_rows(
        16,
        (0.0, "UNKNOWN", "start of capture"),
        (0.9, "PRE-OPERATIONAL", "boot-up"),
        (2.4, "OPERATIONAL", "heartbeat"),
        (420.0, "UNKNOWN", "capture gap"),
        (421.5, "OPERATIONAL", "heartbeat"),
        (430.0, "STOPPED", "command stop"),
    )
    return states + state_rows(33, (0.0, "UNKNOWN", "no error control heard"))


def _bad_day_emcy() -> list[EmcyRow]:
    return [
        emcy_row(10, 249.9, 0x3100, meaning="mains voltage", error_register=0x05,
                 registers=["generic", "voltage"]),
        emcy_row(10, 281.2),
        emcy_row(10, 284.0, 0x0000, meaning="no error", error_register=0, registers=[],
                 transition="all cleared"),
        emcy_row(10, 500.1, None, meaning="only 2 bytes", error_register=None, registers=[],
                 manufacturer_hex="", transition="malformed"),
        *(emcy_row(16, 520.0 + k, 0x8110, meaning="CAN overrun (objects lost)",
                   manufacturer_hex="01 00 00 00 00", details={"alarms": 1, "warnings": 0},
                   transition="further" if k else "raised") for k in range(3)),
    ]  # fmt: skip


def _bad_day_findings() -> list[Finding]:
    return [
        finding(),
        finding("emcy.still_active", 520.0, node=16, end_ns=at(600),
                text="Node 16 reported EMCY 8110h (CAN overrun) and never cleared it.",
                cause="The node received more than it could take in.",
                check_next="Bus load and the PDOs that node 16 consumes."),
        finding("pdo.missed", 300.0, severity="warning", node=10, end_ns=at(300.4),
                text="TPDO1 of node 10 (18Ah) missed 3 SYNCs.",
                cause="The node was busy or its answer was overtaken.",
                check_next="Load of node 10, transmission type 1800h:02."),
        finding("capture.gap", 420.0, severity="info", node=None, end_ns=at(421.5),
                text="The recorder was blind for 1.5 s: adapter lost.",
                cause="USB adapter reconnected.", check_next="USB cable of the recorder."),
    ]  # fmt: skip


def services() -> Analysis:
    """A capture with everything that is shown only where there is something to show."""
    states = [
        BusStateRow("can0", "active", at(0), at(10), "", None),
        BusStateRow("can0", "passive", at(10), at(12), "error frame", 5, 128, 0),
        BusStateRow("can1", "active", at(0), at(600), "", None),
    ]
    read = [
        ErrorHistoryRow("can0", 10, 70, at(7), 0x1003, 1, 0x3100, 0x3100, 0, "mains voltage",
                        "seen", 60),
        ErrorHistoryRow("can0", 10, 71, at(7.1), 0x1003, 2, 0x4200, 0x4200, 0, "device temperature",
                        "older", None, "from before the capture"),
        ErrorHistoryRow("can0", 10, 72, at(7.2), 0x1001, 0, 0, None, None, "no error", "register",
                        None),
    ]  # fmt: skip
    around = {"6010h:00": {"name": "Slope", "unit": "deg", "before": 5.25, "after": 5.5}}
    return analysis(
        nodes=[node_row(10, name="tilt")],
        emcy=[emcy_row(10, second=6.0, seq=60, details={"alarms": 1, "alarms_bits": ["code"]})],
        emcy_context=[
            EmcyContextRow("can0", 10, 60, at(6), 0x3100, "OPERATIONAL", "observed", "passive",
                           0x6003, 0, 55, 2.0, ["6003h:00 = 5 (Preset), 2 ms before"], around)
        ],
        error_history=read,
        bus_states=states,
        bus_errors=[BusErrorRow("can0", "stuff error", 20, at(9), at(11), [5])],
        lss=[LssRow("can0", 80, at(8), "master", "switch", "switch mode: configuration")],
        time_stamps=[
            TimeStampRow("can0", 0x100, 90, at(9), at(9.5), SECOND // 2, "2026-03-02 06:00:09.500"),
            TimeStampRow("can0", 0x100, 95, at(69), at(70), SECOND, "2026-03-02 06:01:10"),
        ],
        objects=[ObjectRow("can0", 10, 0x1017, 0, "Producer heartbeat time", "ms", 200, "sdo-write",
                           3, at(1), since_seq=3)],
        object_changes=[ObjectChangeRow("can0", 10, 3, at(1), 0x1017, 0, "Producer heartbeat time",
                                        "ms", 0, 200, "heartbeat every 200 ms",
                                        "SDO client on 60Ah", "sdo-write", 0x60A, saved=False)],
        device_health=[DeviceHealthRow("can0", 10, "jn2100", "temperature", 0x4080, 0, "degC", 2,
                                       24.5, 25.0, 24.5, 25.0, at(1), at(9), 4, 70)],
    )  # fmt: skip


def many_nodes(count: int = 40, buses: tuple[str, ...] = ("can0", "can1")) -> Analysis:
    """A full line on two buses."""
    pairs = [(buses[n % len(buses)], n) for n in range(1, count + 1)]
    return analysis(
        capture=capture_row(buses=list(buses)),
        nodes=[node_row(n, bus=bus, name=f"drive {n}") for bus, n in pairs],
        nmt_states=[row for bus, n in pairs for row in usual_states(n, 0.2 + n / 20, bus)],
        bus_load=[BusLoadRow(bus, 250_000, 20.0, 30.0, 500.0) for bus in buses],
        series=[
            series("bus load", "%", np.full(600, 20.0 + i), bus) for i, bus in enumerate(buses)
        ],
    )


def untimed() -> Analysis:
    """A log without times: every stamp is 0, only the order is known."""
    row = NmtStateRow("can0", 10, "OPERATIONAL", 0, 0, "heartbeat", "observed", 12)
    return analysis(
        capture=capture_row(
            start_utc_ns=None, first_ns=0, duration_ns=0, time_base="none", frames=100
        ),
        nodes=[node_row(10)],
        nmt_states=[row],
        emcy=[emcy_row(t_ns=0, seq=40)],
        findings=[finding(start_ns=0, end_ns=0)],
    )


def measured() -> Analysis:
    """Two encoders on one shaft and an inclinometer, with everything that was found out of them."""
    one, two, slope = shaft(6_000), shaft(3_000, 6), tilt(0x601000, "Slope long", 40.0)
    rows = [
        replace(
            trace_row(one), assumed=["range"], mean_deg=121.5, std_deg=130.0, direction_changes=7,
            rest_samples=128, noise_deg=0.012, noise_peak_deg=0.05, sources={"185h": 6_000},
            speed_max_rpm=40.03, told_below_rpm=118.4, untold_speeds=3,
        ),
        replace(trace_row(two), cuts=2, flags={"wrap": 4, "frozen": 9, "scale_assumed": 3_000}),
        replace(trace_row(slope), mean_deg=359.98, std_deg=2.61, direction_changes=0,
                speed_max_rpm=0.2, sources={"18Ah": 5_000, "SDO": 2}),
    ]  # fmt: skip
    cuts = [
        (5, 0x600400, "capture gap: adapter lost"), (6, 0x600400, "preset (6003h written)"),
        (6, 0x600400, "node lost for 3.1 s"), (10, 0x601000, "boot-up"),
    ]  # fmt: skip
    health = DeviceHealthRow("can0", 5, "lir-da158a", "EEPROM writes", 0x1011, 4, "writes", 2,
                             1200.0, 1204.0, 1200.0, 1204.0, at(1), at(9), 4, 70,
                             note="+4 between the first and the last read")  # fmt: skip
    return analysis(
        nodes=[
            node_row(5, name="drum", device="lir-da158a", device_source="objects",
                     device_reason='1008h = "L158" (frame 12)'),
            node_row(6, name="brake", device_guess=["lir-ma158k"], device_reason="8 bytes in 186h"),
            node_row(10, name="boom"),
        ],
        traces=rows,
        trace_data=[one, two, slope],
        trace_events=[
            TraceEventRow("can0", node, object, "cut", 7 + k, at(265), None, None, text)
            for k, (node, object, text) in enumerate(cuts)
        ],
        shafts=[ShaftRow("can0", 6, "can0", 5, 1.0, 2_900, 7, 12.5, 9.1, 2.0, 2, at(300), 4711, 12.0)],
        followers=[FollowerRow("can0", 10, 5, -2.5, at(3), at(590), 800, 1440.0, 0.4)],
        tilts=[TiltRow("can0", 10, 0x601000, "perpendicular", "", 5_000, 0, 0, 0, 0, None, None,
                       None, ["two formulas are possible: choose perp_formula"], ["res"])],
        device_health=[health],
        object_changes=[ObjectChangeRow("can0", 5, 700, at(250), 0x6003, 0, "Preset value", "counts",
                                        0, 1000, "preset to 1000", "SDO client on 605h",
                                        "sdo-write", 0x605, saved=True)],
    )  # fmt: skip
