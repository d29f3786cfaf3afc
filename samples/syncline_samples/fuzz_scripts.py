"""What may go wrong in a random scenario; each script adds one thing to a plan.

A script adds nothing where it cannot happen. The times leave room for the machine to recover, so
that what follows does not hide what an analyzer must tell of it.
"""

from collections.abc import Callable
from dataclasses import replace

from syncline_samples import faults
from syncline_samples.devices.errors import ERRORS
from syncline_samples.fuzz_plan import (
    Plan,
    beats,
    guarded,
    is_lir,
    period_ms,
    readable,
    restart_s,
    some,
)
from syncline_samples.fuzz_settings import (
    factory_reset,
    lss,
    lss_number,
    move_emcy,
    move_pdo,
    move_sdo,
    move_sync,
    new_number,
    pdo_inhibit_time,
    remap,
    reset_by_sdo,
    store,
)
from syncline_samples.machine import LIR_MODELS, DeviceSpec
from syncline_samples.master import PRE_OPERATIONAL, RESET_COMMUNICATION, RESET_NODE, START, STOP
from syncline_samples.node import State
from syncline_samples.sdo_client import OnTimeout, read, write

Script = Callable[[Plan], None]
NMT_NOISE = (b"", b"\x01", b"\x55\x00", b"\x01\x80")
"""No commands: too short, an unknown specifier, a number that no node can have."""


def _speaks(plan: Plan, spec: DeviceSpec) -> bool:
    """Whether a node tells its states: after a remote frame the heartbeats of a LIR are empty."""
    return not (is_lir(spec) and plan.had(faults.RemoteOnHeartbeat, spec))


def _watchdog(plan: Plan) -> None:
    spec = plan.node(lambda spec: period_ms(spec) >= 200)
    if spec is not None:
        boot_ms = plan.random.randint(20, 120)
        plan.add(faults.WatchdogReset(spec.node_id, plan.now_s, boot_ms), 3.5)


def _power_loss(plan: Plan) -> None:
    spec = plan.node()
    if spec is not None:
        off_s = plan.between(0.3, 3.0)
        plan.add(faults.PowerLoss(spec.node_id, plan.now_s, off_s), off_s + 1.5)


def _boot_loop(plan: Plan) -> None:
    spec = plan.node()
    if spec is not None:
        count, every_ms = plan.random.randint(3, 5), plan.random.randint(600, 1200)
        loop = faults.BootLoop(spec.node_id, plan.now_s, count, every_ms)
        plan.add(loop, count * every_ms / 1000 + 1.5)


def _cable(plan: Plan) -> None:
    spec = plan.node(beats)
    if spec is not None:
        for_s = plan.between(2.2, 3.5) * period_ms(spec) / 1000
        plan.add(faults.CableLoose(spec.node_id, plan.now_s, for_s), for_s + 1.5)


def _bus_off(plan: Plan) -> None:
    spec = plan.node(beats)
    if spec is not None:
        for_s = plan.between(0.2, 2.0)
        plan.add(faults.NodeBusOff(spec.node_id, plan.now_s, for_s), for_s + 2.0)


def _master_silent(plan: Plan) -> None:
    """So short that no node misses the master, or so long that every guarded one does."""
    specs = [spec for spec in plan.devices if guarded(spec)]
    if specs:
        long_s = max(spec.guard_ms * spec.life_factor for spec in specs) / 1000
        short_s = min(spec.guard_ms * (spec.life_factor - 2) for spec in specs) / 1000
        for_s = plan.between(long_s + 0.02, 2.5 * long_s)
        if short_s and plan.random.random() < 0.5:
            for_s = plan.between(0.02, short_s - 0.01)
        plan.add(faults.MasterSilent(plan.now_s, for_s, 1.0), for_s + 2.0)


def _remote(plan: Plan) -> None:
    spec = plan.node(beats)
    if spec is not None:
        plan.add(faults.RemoteOnHeartbeat(spec.node_id, plan.now_s), 1.5)


def _toggle(plan: Plan) -> None:
    spec = plan.node(guarded)
    if spec is not None:
        count = plan.random.randint(3, 6)
        stuck = faults.GuardToggleStuck(spec.node_id, plan.now_s, count)
        plan.add(stuck, count * spec.guard_ms / 1000 + 0.5)


def _unanswered(plan: Plan) -> None:
    """So few that the node, which starts its life time with each answer, does not miss the master."""
    spec = plan.node(lambda spec: guarded(spec) and spec.life_factor >= 4)
    if spec is not None:
        count = plan.random.randint(1, 2)
        plan.add(faults.GuardUnanswered(spec.node_id, plan.now_s, count), 2.0)


def _heartbeat_period(plan: Plan) -> None:
    """Of a node whose 1017h the master has written: else nobody can know what it should be."""
    spec = plan.node(lambda spec: beats(spec) and not spec.stored_heartbeat_ms and not plan.late)
    if spec is not None:
        percent = plan.random.choice((60, 90, 110, 130, 170, 220))
        plan.add(faults.HeartbeatPeriod(spec.node_id, plan.now_s, percent, 4.0), 5.0)


def _unknown_state(plan: Plan) -> None:
    spec = plan.node(lambda spec: beats(spec) and _speaks(plan, spec))
    if spec is not None:
        byte = plan.random.choice((0x33, 0x01, 0x7E))
        plan.add(faults.UnknownState(spec.node_id, plan.now_s, byte, 2.0), 3.0)


def _heartbeat_jitter(plan: Plan) -> None:
    spec = plan.node(beats)
    if spec is not None:
        percent = plan.random.randint(5, 40)
        plan.add(faults.HeartbeatIrregular(spec.node_id, plan.now_s, percent, 3.0), 3.5)


def _heartbeats_missing(plan: Plan) -> None:
    spec = plan.node(beats)
    if spec is not None:
        count = plan.random.randint(1, 3)
        busy_s = (count + 3) * spec.heartbeat_ms / 1000
        plan.add(faults.HeartbeatsMissing(spec.node_id, plan.now_s, count), busy_s)


def _ignored(plan: Plan) -> None:
    spec = plan.node()
    if spec is not None:
        specifier = plan.random.choice((STOP, PRE_OPERATIONAL))
        plan.add(faults.CommandIgnored(spec.node_id, plan.now_s, specifier), 2.0)


def _command(plan: Plan) -> None:
    """Stop or PRE-OPERATIONAL, and start again."""
    spec = plan.random.choice((None, plan.node()))
    node_id = 0 if spec is None else spec.node_id
    specifier = plan.random.choice((STOP, PRE_OPERATIONAL))
    plan.add(faults.Command(plan.now_s, specifier, node_id), plan.between(0.02, 1.5))
    plan.add(faults.Command(plan.now_s, START, node_id), 0.5)


def _reset(plan: Plan) -> None:
    spec = plan.random.choice((None, plan.node()))
    specifier = plan.random.choice((RESET_NODE, RESET_COMMUNICATION))
    concerned = plan.devices if spec is None else (spec,)
    busy_s = max(restart_s(each) for each in concerned)
    plan.add(faults.Command(plan.now_s, specifier, 0 if spec is None else spec.node_id), busy_s)


def _leaves(plan: Plan) -> None:
    """Not of an encoder that may boot with the same byte, as far as the recording tells."""
    spec = plan.node(
        lambda spec: _speaks(plan, spec) and not (plan.late and spec.device in LIR_MODELS[1:])
    )
    if spec is not None:
        to = plan.random.choice((State.PRE_OPERATIONAL, State.STOPPED))
        for_s = plan.between(2.5, 4.0) * period_ms(spec) / 1000 + 0.2
        plan.add(faults.LeavesOperational(spec.node_id, plan.now_s, to, for_s), for_s + 0.5)


def _rogue(plan: Plan) -> None:
    """Of a node that tells that it is PRE-OPERATIONAL: else it may as well ignore the command."""
    spec = plan.node(lambda spec: spec.device != "io" and plan.sync_us and _speaks(plan, spec))
    if spec is not None:
        for_s = plan.between(0.5, 2.0)
        plan.add(faults.PdoOutsideOperational(spec.node_id, plan.now_s, for_s), for_s + 1.5)


def _nmt_noise(plan: Plan) -> None:
    plan.add(faults.MalformedCommand(plan.now_s, plan.random.choice(NMT_NOISE)), 0.3)


def _codes(spec: DeviceSpec) -> list[int]:
    """Errors of a device; those that say that it was bus-off come with that fault."""
    return sorted(set(ERRORS[spec.device]) - {0x7510, 0x8140})


def _emcy(plan: Plan) -> None:
    """One or two errors that overlap, each for a while or for good."""
    spec = plan.node()
    if spec is None:
        return
    known = ERRORS[spec.device]
    for code in plan.random.sample(_codes(spec), plan.random.randint(1, 2)):
        for_s = plan.random.choice((None, plan.between(0.1, 3.0)))
        fault = faults.Emcy(spec.node_id, plan.now_s, code, *known[code], for_s=for_s)
        plan.add(fault, plan.between(0.1, 0.8))
    plan.wait(3.0)


def _errors(plan: Plan) -> None:
    """Several errors that come and go in any order."""
    spec = plan.node()
    if spec is None:
        return
    codes = plan.random.sample(_codes(spec), 3)
    begins = [plan.between(0.0, 1.0) for _ in codes]
    steps = [(begin, "+", code) for begin, code in zip(begins, codes, strict=True)]
    steps += [
        (round(begin + plan.between(0.05, 1.5), 3), "-", code)
        for begin, code in zip(begins, codes, strict=True)
        if plan.random.random() < 0.7
    ]
    plan.add(faults.Errors(spec.node_id, plan.now_s, tuple(steps)), 3.0)


def _storm(plan: Plan) -> None:
    """Of a node that no inhibit time holds back."""
    spec = plan.node(lambda spec: not plan.had(faults.EmcyInhibitTime, spec))
    if spec is not None:
        code = plan.random.choice(_codes(spec))
        register, alarms, _ = ERRORS[spec.device][code]
        count, every_ms = plan.random.randint(8, 40), plan.random.randint(10, 60)
        storm = faults.EmcyStorm(spec.node_id, plan.now_s, count, every_ms, code, register, alarms)
        plan.add(storm, 2 * count * every_ms / 1000 + 0.5)


def _short_emcy(plan: Plan) -> None:
    spec = plan.node()
    if spec is not None:
        plan.add(faults.EmcyMalformed(spec.node_id, plan.now_s, plan.random.randint(2, 7)), 1.0)


def _emcy_stopped(plan: Plan) -> None:
    """Of a node that has no other errors: the message clears them all."""
    spec = plan.node(lambda spec: not plan.had(faults.Emcy, spec))
    if spec is not None:
        plan.add(faults.EmcyWhileStopped(spec.node_id, plan.now_s), 2.5)


def _inhibit(plan: Plan) -> None:
    spec = plan.node(lambda spec: spec.device not in ("haomiao-38", "lir-da158"))
    if spec is not None:
        hasty = plan.random.random() < 0.5
        plan.add(faults.EmcyInhibitTime(spec.node_id, plan.now_s, hasty=hasty), 1.5)


def _history(plan: Plan) -> None:
    spec = plan.node()
    if spec is not None:
        plan.add(faults.ErrorHistory(spec.node_id, plan.now_s), 0.5)


def _synchronous(plan: Plan) -> DeviceSpec | None:
    """The second TPDO is synchronous on every device that has one."""
    return plan.node(lambda spec: spec.device != "io" and plan.sync_us)


def _missed(plan: Plan) -> None:
    spec = _synchronous(plan)
    if spec is not None:
        count = plan.random.randint(1, 6)
        busy_s = 2 * count * plan.sync_us / 1e6 + 0.5
        plan.add(faults.MissedPdos(spec.node_id, plan.now_s, 2, count), busy_s)


def _tpdo_stops(plan: Plan) -> None:
    spec = _synchronous(plan)
    if spec is not None:
        for_s = plan.between(1.0, 2.0)
        plan.add(faults.TpdoStops(spec.node_id, plan.now_s, 2, for_s), for_s + 0.5)


def _extra(plan: Plan) -> None:
    """Of a TPDO that answers every SYNC: beside others, a second one may look like an answer."""
    spec = plan.node(lambda spec: spec.device in ("haomiao-38", "jn2100") and plan.sync_us)
    if spec is not None:
        plan.add(faults.ExtraPdos(spec.node_id, plan.now_s), 1.5)


def _requests(plan: Plan) -> None:
    """For a TPDO of an inclinometer, which answers at any time."""
    spec = plan.node(lambda spec: spec.device == "jn2100")
    if spec is not None:
        plan.add(faults.PdoRequests(spec.node_id, plan.now_s), 1.5)


def _short_pdo(plan: Plan) -> None:
    spec = _synchronous(plan)
    if spec is not None:
        plan.add(faults.WrongLengthPdos(spec.node_id, plan.now_s, for_s=1.0), 1.5)


def _missing_syncs(plan: Plan) -> None:
    if plan.sync_us:
        count = plan.random.randint(1, 5)
        plan.add(faults.MissingSyncs(plan.now_s, count), count * plan.sync_us / 1e6 + 0.3)


def _sync_outage(plan: Plan) -> None:
    if plan.sync_us:
        for_s = plan.between(0.3, 1.5)
        plan.add(faults.SyncOutage(plan.now_s, for_s), for_s + 0.5)


def _sync_jitter(plan: Plan) -> None:
    if plan.sync_us:
        for_s = 60 * plan.sync_us / 1e6
        jitter_us = plan.random.randint(plan.sync_us // 4, plan.sync_us * 2 // 5)
        plan.add(faults.SyncJitter(plan.now_s, for_s, jitter_us), for_s + 0.3)


def _two_syncs(plan: Plan) -> None:
    if plan.sync_us:
        plan.add(faults.SecondSyncProducer(plan.now_s), 3.5)


def _recorder_off(plan: Plan) -> None:
    for_s = plan.between(0.2, 2.0)
    plan.add(faults.RecorderBusOff(plan.now_s, for_s), for_s + 0.8)


def _gap(plan: Plan) -> None:
    for_s = plan.between(0.05, 2.0)
    plan.add(faults.RecorderGap(plan.now_s, for_s), for_s + 0.8)


def _overrun(plan: Plan) -> None:
    plan.add(faults.Overrun(plan.now_s, plan.random.randint(5, 50)), 0.8)


def _controller(plan: Plan) -> None:
    passive = plan.random.random() < 0.5
    plan.add(faults.ControllerState(plan.now_s, 1.0, passive), 1.5)


def _error_frames(plan: Plan) -> None:
    kind = plan.random.choice(("stuff", "form", "crc", "ack"))
    plan.add(faults.ErrorFrames(plan.now_s, 5, 100, kind), 1.0)


def _clock(plan: Plan) -> None:
    step_ms = plan.random.choice((-1, 1)) * plan.random.randint(20, 3000)
    plan.add(faults.ClockStep(plan.now_s, step_ms), 0.8)


def _angle_jump(plan: Plan) -> None:
    """The speed limit of the Haomiao is printed; its set input changes little the second time."""
    spec = plan.node(
        lambda spec: (
            spec.device == "haomiao-38"
            and not plan.had(faults.Preset, spec)
            and not plan.had(faults.AngleJump, spec)
        )
    )
    if spec is not None:
        plan.add(faults.AngleJump(spec.node_id, plan.now_s), 0.5)


def _preset(plan: Plan) -> None:
    spec = plan.node(lambda spec: spec.device in (*LIR_MODELS, "haomiao-38"))
    if spec is not None:
        value = plan.random.randint(0, 8000)
        plan.add(faults.Preset(spec.node_id, plan.now_s, value), 0.5)


def _access(plan: Plan) -> None:
    spec = plan.node()
    if spec is not None:
        jobs = some(plan.random, readable(spec))
        plan.add(faults.SdoAccess(spec.node_id, plan.now_s, jobs), 0.5)


def _refused(plan: Plan) -> None:
    spec = plan.node()
    if spec is not None:
        job = plan.random.choice((read(0x5FFF), write(0x1018, 1, 7, 4), read(0x1018, 9)))
        plan.add(faults.SdoRefused(spec.node_id, plan.now_s, job), 0.5)


def _sdo_silent(plan: Plan) -> None:
    spec = plan.node()
    if spec is not None:
        plan.add(faults.SdoSilent(spec.node_id, plan.now_s, 1.0), 1.5)


def _two_clients(plan: Plan) -> None:
    spec = plan.node()
    if spec is not None:
        apart_us = plan.random.randint(100, 400)
        plan.add(faults.SdoTwoClients(spec.node_id, plan.now_s, apart_us=apart_us), 0.5)


def _broken_off(plan: Plan) -> None:
    """A transfer of several steps that one side ends, or does not end."""
    spec = plan.node(lambda spec: spec.device in ("jn2100", "io"))
    if spec is not None:
        kinds = (
            faults.SdoServerAborts,
            faults.SdoClientAborts,
            faults.SdoClientStops,
            faults.SdoServerStops,
        )
        plan.add(plan.random.choice(kinds)(spec.node_id, plan.now_s), 2.0)


def _late(plan: Plan) -> None:
    spec = plan.node()
    if spec is not None:
        then = plan.random.choice(((), (read(0x1018, 1),)))
        said: OnTimeout = plan.random.choice(("silent", "abort"))
        plan.add(faults.SdoLate(spec.node_id, plan.now_s, on_timeout=said, then=then), 1.5)


def _reset_in_transfer(plan: Plan) -> None:
    spec = plan.node()
    if spec is not None:
        after_us = plan.random.randint(300, 5000)
        reset = faults.SdoReset(spec.node_id, plan.now_s, after_us=after_us)
        plan.add(reset, restart_s(spec))


def _block(plan: Plan) -> None:
    spec = plan.node(lambda spec: spec.device == "io")
    if spec is not None:
        job = replace(faults.LOG, block_size=plan.random.choice((5, 20, 127)))
        kind = plan.random.choice((faults.BlockSegmentsLost, faults.BlockCrcWrong))
        plan.add(kind(spec.node_id, plan.now_s, job), 1.0)


def _search(plan: Plan) -> None:
    taken = {spec.node_id for spec in plan.devices}
    absent = tuple(node for node in (61, 62, 63) if node not in taken)
    plan.add(faults.NodeSearch(plan.now_s, absent), 2.0)


def _time(plan: Plan) -> None:
    plan.add(faults.TimeService(plan.now_s), 1.0)


def _twin(plan: Plan) -> None:
    """A second device of the same number, whose heartbeat has another period."""
    spec = plan.node(beats)
    if spec is not None:
        twin = faults.DuplicateNode(spec.node_id, plan.now_s, heartbeat_ms=spec.heartbeat_ms + 130)
        plan.add(twin, max(14.0, spec.heartbeat_ms / 25))


def _switched_off(plan: Plan) -> None:
    off_s = plan.between(2.0, 4.0)
    busy_s = max(restart_s(spec) for spec in plan.devices)
    plan.add(faults.BusPowerOff(plan.now_s, off_s), off_s + 1.5 + busy_s)


SCRIPTS: tuple[Script, ...] = (
    *(_watchdog, _power_loss, _boot_loop, _cable, _bus_off),
    *(_master_silent, _remote, _toggle, _unanswered),
    *(_heartbeat_period, _heartbeat_jitter, _heartbeats_missing),
    *(_ignored, _command, _command, _reset, _leaves, _rogue, _nmt_noise, _unknown_state),
    *(_emcy, _emcy, _errors, _errors, _storm, _short_emcy, _emcy_stopped, _inhibit, _history),
    *(_missed, _tpdo_stops, _extra, _short_pdo, _requests),
    *(_missing_syncs, _sync_outage, _sync_jitter, _two_syncs),
    *(_recorder_off, _gap, _overrun, _controller, _error_frames, _clock),
    *(_angle_jump, _preset),
    *(_access, _refused, _sdo_silent, _two_clients, _broken_off, _late, _reset_in_transfer),
    *(_block, _search, _time),
    *(move_pdo, move_emcy, remap, store, reset_by_sdo),
    *(pdo_inhibit_time, lss),
)
"""From all these a machine recovers."""
ENDINGS: tuple[Script, ...] = (
    _twin,
    new_number,
    _switched_off,
    move_sync,
    move_sdo,
    lss_number,
    factory_reset,
)
"""After these the machine is another one, or begins anew."""
