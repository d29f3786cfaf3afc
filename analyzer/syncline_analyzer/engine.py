"""One pass over a session: frames through all folds, tables, findings."""

from collections.abc import Callable, Iterable, Mapping, Sequence

from syncline_analyzer.bit_rates import BitRates
from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.capture_row import capture_row
from syncline_analyzer.deafness import Numbered
from syncline_analyzer.device_health import device_health_rows
from syncline_analyzer.doubled_rows import doubled_rows
from syncline_analyzer.findings import find_all
from syncline_analyzer.first_context import first_context
from syncline_analyzer.fold import Fold
from syncline_analyzer.folds.angle.fold import AngleFold
from syncline_analyzer.folds.control import ControlFold
from syncline_analyzer.folds.emcy.context import emcy_context
from syncline_analyzer.folds.emcy.history import error_history
from syncline_analyzer.folds.nmt.kept_waiting import told_waiting
from syncline_analyzer.folds.timing.fold import TimingFold
from syncline_analyzer.nodes import node_rows
from syncline_analyzer.object_changes import object_change_rows
from syncline_analyzer.objects import history_rows, object_rows
from syncline_analyzer.pdo_lengths import PdoLengths, length_rows
from syncline_analyzer.preparing import Preparation, Prepared, Step
from syncline_analyzer.results import Analysis
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.collecting import rare_collections
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import Device

Progress = Callable[[int], None]
"""Called after each batch with the number of frames taken in so far."""


@rare_collections()
def analyze(
    stream: Iterable[Numbered],
    facts: Sequence[CaptureFacts],
    buses: list[str],
    *,
    description: BusDescription,
    devices: Mapping[int, Device],
    bitrate: int | None = None,
    data_bitrate: int | None = None,
    origin_ns: int | None = None,
    progress: Progress | None = None,
) -> Analysis:
    """Analyze a stream of (`seq`, batch or gap) in this process, as `analyze_prepared` does.

    Args:
        stream: batches and gaps in capture order.
        facts: of every file; complete once the stream is read.
        buses: names by bus number; may grow while the stream is read.
    """
    return analyze_prepared(
        Preparation(stream, facts, buses),
        description=description,
        devices=devices,
        bitrate=bitrate,
        data_bitrate=data_bitrate,
        origin_ns=origin_ns,
        progress=progress,
    )


def analyze_prepared(
    prepared: Prepared,
    *,
    description: BusDescription,
    devices: Mapping[int, Device],
    bitrate: int | None = None,
    data_bitrate: int | None = None,
    origin_ns: int | None = None,
    progress: Progress | None = None,
) -> Analysis:
    """Run all folds over prepared frames and join what they found.

    Args:
        prepared: frames and gaps, and what is known of the files.
        description: what the user says of buses and nodes.
        devices: device by node id, where the description leaves it open.
        bitrate: bit/s of every bus whose bit rate is not told otherwise.
        data_bitrate: the same of the data phase of FD frames.
        origin_ns: first stamp of the whole capture, from which capture time counts; by default
            the first one of the stream.
    """
    facts = prepared.facts
    context = first_context(facts, prepared.buses, description, devices)
    control, timing, angle = ControlFold(context), TimingFold(context), AngleFold(context)
    folds: tuple[Fold, ...] = (control, timing, angle, PdoLengths(context))
    rates = BitRates(context, facts, bitrate, data_bitrate)
    for step in rates.settled(prepared.steps()):
        _feed(folds, step)
        if progress:
            progress(step.frames)
    end_ns = prepared.census.end_ns
    controls = control.finish(end_ns)
    unread = [place for each in facts for place in each.unread]
    timings = timing.finish(
        end_ns,
        controls.nmt.states,
        controls.nmt.commands,
        unread,
        controls.nmt.nodes,
        prepared.silence,
    )
    starts = [(boot.bus, boot.node, boot.t_ns) for boot in controls.nmt.boot_ups]
    lost = [
        (row.bus, row.node, row.start_ns, row.end_ns)
        for row in controls.nmt.states
        if row.state == NmtState.LOST
    ]
    angles = angle.finish(end_ns, starts, lost)
    nodes = node_rows(context, controls, timings.pdos)
    analysis = Analysis(
        capture=capture_row(prepared.census, facts, context, origin_ns),
        nodes=nodes,
        nmt_commands=controls.nmt.commands,
        nmt_states=told_waiting(context, controls.nmt.states, controls.nmt.timelines),
        sync=timings.sync,
        pdos=timings.pdos,
        emcy=controls.emcy.rows,
        errors=controls.emcy.errors,
        sdo=controls.sdo.rows,
        traces=angles.traces,
        bus_load=timings.bus_load,
        findings=[],
        trace_data=angles.trace_data,
        responses=timings.responses,
        holes=timings.holes,
        sync_jitter=timings.sync_jitter,
        trace_events=angles.events,
        tilts=angles.tilts,
        tilt_data=angles.tilt_data,
        shafts=angles.shafts,
        followers=angles.followers,
        shaft_data=angles.shaft_data,
        series=timings.series,
        objects=object_rows(context, nodes),
        object_history=history_rows(context),
        pdo_pauses=timings.pdo_pauses,
        clock_steps=timings.clock_steps,
        bus_silences=timings.bus_silences,
        overloads=timings.overloads,
        bus_shares=timings.bus_shares,
        node_shares=timings.node_shares,
        waits=timings.waits,
        delays=timings.delays,
        lateness=timings.lateness,
        sync_doubles=timings.sync_doubles,
        error_control_periods=timings.error_control_periods,
        worst=timings.worst,
        unsent_pdos=timings.unsent_pdos,
        bus_states=controls.bus_errors.states,
        bus_errors=controls.bus_errors.kinds,
        lss=controls.lss.rows,
        time_stamps=controls.time.rows,
        doubled=doubled_rows(prepared.doubled, context.buses),
        pdo_lengths=length_rows(context),
    )
    if unlisted := controls.sdo.unlisted:
        analysis.capture.notes.append(f"{unlisted} more SDO transfers are counted, but not listed")
    for bus in sorted(controls.nmt.foreign):
        analysis.capture.notes.append(
            f"{context.bus_name(bus)} shows no CANopen: another protocol uses its identifiers"
        )
    analysis.capture.notes.extend(rates.notes())
    bus_states = controls.bus_errors.states
    analysis.emcy_context.extend(emcy_context(analysis, bus_states, timed=context.timed))
    analysis.error_history.extend(error_history(controls, context, analysis.capture.gaps))
    analysis.object_changes.extend(object_change_rows(context, controls.sdo.rows, controls.lss))
    analysis.device_health.extend(
        device_health_rows(context, controls.sdo.rows, analysis.error_history)
    )
    analysis.findings.extend(find_all(analysis, controls, context))
    return analysis


def _feed(folds: Sequence[Fold], step: Step) -> None:
    """Take a step in: each batch through all folds before the next one, then the gap."""
    for batch in step.batches:
        for fold in folds:
            fold.update(batch)
    if step.gap is not None:
        for fold in folds:
            fold.gap(step.gap)
