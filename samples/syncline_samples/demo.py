"""`syncline demo`: simulate a bad day, record it, analyze it, and hold the result to the script."""

import importlib.util
import threading
import time
import webbrowser
from dataclasses import replace
from pathlib import Path

import click

from syncline_analyzer.session import open_session
from syncline_analyzer.views.files import write_all
from syncline_logger.record_options import RecordOptions
from syncline_logger.recorder import record, record_batches
from syncline_logger.recording import RecordResult
from syncline_samples.comparison import Comparison, compare
from syncline_samples.faults import ClockStep, RecorderGap
from syncline_samples.machine import Run, Scenario
from syncline_samples.scenarios import bad_day
from syncline_samples.truth import ExpectedFinding
from syncline_schemas.capture.layout import BusInfo
from syncline_schemas.description import BusDescription
from syncline_schemas.wording import counted

CAPTURE_NAME = "bad_day.mcap"
NOT_REACHED = 1
"""Exit code when analyzer and script disagree."""
NEEDED = ("pandas", "pyarrow", "rerun")
"""Packages of the analyzer extra, which the last step needs."""
_CHANNEL = "syncline-demo"
_LEAD_NS = 1_000_000_000
_SETTLE_S = 0.5
"""After the last frame, for the recorder to take it."""


@click.command(
    epilog="\b\nExamples:\n"
    "  syncline demo\n"
    "  syncline demo --out bad-day --seconds 40 --real-time --open"
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("syncline-demo"),
    show_default=True,
    metavar="DIR",
    help="Where to write the capture, report.html, session.rrd and the tables.",
)
@click.option(
    "--seconds",
    type=click.FloatRange(min=10),
    default=120.0,
    show_default=True,
    metavar="N",
    help="How much of the day to simulate; the last fault comes at 104 s.",
)
@click.option("--real-time", is_flag=True, help="Let the day pass on a virtual bus of python-can.")
@click.option("--open", "show", is_flag=True, help="Show report.html in the browser.")
@click.pass_context
def demo(ctx: click.Context, out: Path, seconds: float, real_time: bool, show: bool) -> None:
    """Run the whole chain on a simulated bus.

    Six encoders and inclinometers and an I/O module have a bad day; the recorder writes it down,
    the analyzer says what happened, and the result is held against the script. Files of an earlier
    demo in DIR are replaced. Exit code 1 when analyzer and script disagree.
    """
    _check_installed()
    begin = time.monotonic()
    scenario = bad_day(seconds)
    if real_time:
        scenario = _beginning_now(_without_recorder_faults(scenario))
    run = scenario.start()
    recorded = _record(run, _free_path(out / CAPTURE_NAME), real_time=real_time)
    _say_recorded(run, recorded)
    session = open_session(recorded.path)
    analysis = session.analysis
    write_all(analysis, out, session.frames)
    comparison = compare(run.truth.findings, analysis.findings)
    _say_compared(comparison, scenario)
    _say_files(out, recorded.path, time.monotonic() - begin)
    if show:
        webbrowser.open((out / "report.html").resolve().as_uri())
    if not comparison.agrees:
        ctx.exit(NOT_REACHED)


def _check_installed() -> None:
    """Raises ModuleNotFoundError before the day is simulated, not after it."""
    for name in NEEDED:
        if importlib.util.find_spec(name) is None:
            raise ModuleNotFoundError(f"No module named '{name}'", name=name)


def _without_recorder_faults(scenario: Scenario) -> Scenario:
    """A recorder of the real kind hears everything and has the clock of its machine."""
    faults = [each for each in scenario.faults if not isinstance(each, RecorderGap | ClockStep)]
    return replace(scenario, faults=tuple(faults))


def _beginning_now(scenario: Scenario) -> Scenario:
    """The scenario on the clock of this machine, with time to open the bus."""
    return replace(scenario, epoch_ns=time.time_ns() + _LEAD_NS)


def _free_path(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    return path


def _record(run: Run, path: Path, *, real_time: bool) -> RecordResult:
    description = BusDescription.loads(run.description_toml)
    options = RecordOptions(description=description, sync=real_time, recording_id="demo")
    if real_time:
        return _record_live(run, path, options)
    scenario = run.scenario
    bus = BusInfo(
        scenario.bus_name,
        0,
        scenario.bitrate,
        interface="simulated",
        clock="simulated",
        resolution_ns=scenario.stamp_resolution_ns,
    )
    return record_batches(run.stream(), [bus], path, options)


def _record_live(run: Run, path: Path, options: RecordOptions) -> RecordResult:
    """Play the run on a virtual bus in one thread, and record it from the other side.

    The stamps are the simulated ones, as an adapter with a clock of its own gives them.
    """
    from syncline_logger.bus_options import BusOptions
    from syncline_logger.lean_can import can
    from syncline_logger.sources.python_can import PythonCanSource
    from syncline_samples.play import play

    scenario = run.scenario
    bus_options = BusOptions(
        scenario.bus_name, interface="virtual", channel=_CHANNEL, bitrate=scenario.bitrate
    )
    stop = threading.Event()

    def perform() -> None:
        with can.Bus(interface="virtual", channel=_CHANNEL, preserve_timestamps=True) as bus:
            play(run, bus)
            time.sleep(_SETTLE_S)
        stop.set()

    player = threading.Thread(target=perform, daemon=True)
    click.echo(f"recording {scenario.seconds:g} s in real time ...", err=True)
    result = record(
        [PythonCanSource(bus_options)], path, options, stop=stop, on_start=lambda _: player.start()
    )
    player.join()
    return result


def _say_recorded(run: Run, recorded: RecordResult) -> None:
    scenario = run.scenario
    click.echo(
        f"A day of {scenario.seconds:g} s on a bus of {scenario.bitrate // 1000} kbit/s with"
        f" {len(scenario.devices)} nodes and a master: {recorded.frame_count} frames,"
        f" bus load {100 * run.truth.bus_load:.1f} %, {counted(recorded.gap_count, 'recorder gap')}.\n"
    )


def _say_compared(comparison: Comparison, scenario: Scenario) -> None:
    for entry, reports in comparison.found:
        click.echo(f"found         {_scripted(entry, scenario)}")
        click.echo(f"              {reports[0].id}: {reports[0].text}")
    for entry in comparison.missing:
        click.echo(f"NOT FOUND     {_scripted(entry, scenario)} ({entry.id})")
    for report in comparison.allowed:
        click.echo(f"besides       {report.id}: {report.text}")
    for report in comparison.unexpected:
        click.echo(f"NOT IN SCRIPT {report.id}: {report.text}")
    wanted = len(comparison.found) + len(comparison.missing)
    click.echo(
        f"\n{len(comparison.found)} of {wanted} scripted faults found,"
        f" {len(comparison.unexpected)} findings that are not in the script."
    )


def _scripted(entry: ExpectedFinding, scenario: Scenario) -> str:
    names = {spec.node_id: spec.name for spec in scenario.devices}
    at_s = (entry.at_ns - scenario.epoch_ns) / 1e9
    where = "bus" if entry.node is None else f"node {entry.node} ({names.get(entry.node, '?')})"
    return f"{at_s:5.1f} s  {where}: {entry.what}"


def _say_files(out: Path, capture: Path, took_s: float) -> None:
    click.echo(f"\ncapture  {capture}")
    click.echo(f"report   {out / 'report.html'}")
    click.echo(f"rerun    {out / 'session.rrd'}")
    click.echo(f"tables   {out / 'tables'}")
    click.echo(f"done in {took_s:.1f} s", err=True)
