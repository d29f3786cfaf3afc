"""What a configuration tool changes in a random scenario: identifiers, numbers, LSS, inhibit times."""

from syncline_samples import faults
from syncline_samples.fuzz_plan import Plan, beats, readable, restart_s, some
from syncline_samples.machine import LIR_MODELS, DeviceSpec
from syncline_samples.master import RESET_COMMUNICATION, RESET_NODE
from syncline_samples.sdo_client import SdoJob, write

FREE_IDS = (0x1FF, 0x2FF, 0x3FF, 0x4FF, 0x57F)
"""PDO identifiers of node 127, which sends none."""
SYNC_IDS = (0x070, 0x07F)
"""Identifiers that CiA 301 gives to nobody."""
_TAKES_1005 = ("haomiao-38", "io", "jn2100")
_FACTORY_NUMBER = 10


def pdo_inhibit_time(plan: Plan) -> None:
    """180xh:3 of an event-driven TPDO, which the module keeps or not."""
    spec = plan.node(lambda spec: spec.device == "io")
    if spec is not None:
        hasty = plan.random.random() < 0.5
        plan.add(faults.PdoInhibitTime(spec.node_id, plan.now_s, hasty=hasty), 1.0)


def lss(plan: Plan) -> None:
    """A tool looks at the module, or is refused what it wants to configure."""
    spec = _only_module(plan)
    if spec is not None:
        refused = plan.random.random() < 0.5
        selective = plan.random.random() < 0.5
        to = _free(plan) if refused else None
        session = faults.LssSession(
            spec, plan.now_s, to, selective=selective, refused=refused, reset=False
        )
        plan.add(session, 1.0)


def lss_number(plan: Plan) -> None:
    """A tool gives the module another number."""
    spec = _only_module(plan)
    if spec is not None:
        plan.add(faults.LssSession(spec, plan.now_s, _free(plan)), 3.0)


def move_sync(plan: Plan) -> None:
    """SYNC moves, and with it every node that can be told."""
    nodes = tuple(spec.node_id for spec in plan.devices if spec.device in _TAKES_1005)
    if plan.sync_us and nodes:
        can_id = plan.random.choice(SYNC_IDS)
        plan.add(faults.MoveSync(plan.now_s, can_id, nodes), 2.0)


def move_sdo(plan: Plan) -> None:
    """1200h of a module, and what the master asks there afterwards."""
    spec = plan.node(lambda spec: spec.device == "io")
    if spec is not None:
        free = _free(plan)
        plan.add(faults.MoveSdo(spec.node_id, plan.now_s, 0x600 + free, 0x580 + free), 1.0)
        plan.wait(restart_s(spec))
        jobs = some(plan.random, readable(spec))
        plan.add(faults.SdoAccess(spec.node_id, plan.now_s, jobs), 0.5)


def factory_reset(plan: Plan) -> None:
    """207Fh of an inclinometer: it comes back as node 10."""
    spec = plan.node(lambda spec: spec.device == "jn2100" and beats(spec))
    if spec is not None and _FACTORY_NUMBER not in _taken(plan):
        plan.add(faults.FactoryReset(spec.node_id, plan.now_s), 1.0 + restart_s(spec))


def move_pdo(plan: Plan) -> None:
    spec = plan.node(lambda spec: spec.device in ("haomiao-38", "io"))
    if spec is not None:
        can_id = plan.random.choice(FREE_IDS)
        if not any(getattr(fault, "can_id", 0) == can_id for fault in plan.faults):
            plan.add(faults.MovePdo(spec.node_id, plan.now_s, can_id), 1.0)


def move_emcy(plan: Plan) -> None:
    """Then an error, which comes on the new identifier."""
    spec = plan.node(lambda spec: spec.device in ("haomiao-38", "io"))
    if spec is not None:
        plan.add(faults.MoveEmcy(spec.node_id, plan.now_s, 0x0FF), 0.3)
        plan.add(faults.Emcy(spec.node_id, plan.now_s, 0x4210, 0x09, for_s=0.5), 1.0)


def remap(plan: Plan) -> None:
    spec = plan.node(lambda spec: spec.device == "haomiao-38")
    if spec is not None:
        entries = plan.random.choice(((0x60040020, 0x65010020), (0x60040020, 0x65020010)))
        plan.add(faults.RemapPdo(spec.node_id, plan.now_s, entries, 2), 1.0)


def store(plan: Plan) -> None:
    """Settings that are written and saved, restored or neither, and then a reset of either kind.

    What a LIR keeps of its heartbeat is not restored: nothing would tell of the node any more.
    """
    spec = plan.node(lambda spec: beats(spec) and (spec.device != "io" or not plan.late))
    if spec is None:
        return
    jobs = some(plan.random, _settings(spec))
    if spec.device != "io" and plan.random.random() < 0.5:
        jobs = (*jobs, write(0x1017, 0, plan.random.choice((200, 400)), 2))
    what = plan.random.choice(("save", "") if spec.stored_heartbeat_ms else ("save", "load", ""))
    specifier = plan.random.choice((RESET_NODE, RESET_COMMUNICATION))
    storage = faults.Storage(spec.node_id, plan.now_s, jobs, what, specifier=specifier)
    plan.add(storage, 0.5 + restart_s(spec))


def _settings(spec: DeviceSpec) -> list[SdoJob]:
    """Writes that change nothing that anybody notices on the bus."""
    found = [write(0x1029, 1, 1, 1)] if spec.device not in ("haomiao-38", "io") else []
    found += (
        [write(0x1016, 1, 0x00640001, 4)] if spec.device not in ("haomiao-38", "jn2100") else []
    )
    if spec.device == "jn2100":
        found += [write(0x2045, 0, 2, 1), write(0x2047, 0, 1, 1), write(0x204A, 0, 1, 1)]
    if spec.device == "io":
        found += [write(0x1800, 3, 20, 2)]
    return found


def reset_by_sdo(plan: Plan) -> None:
    spec = plan.node(lambda spec: spec.device == "jn2100")
    if spec is not None:
        plan.add(faults.ResetBySdo(spec.node_id, plan.now_s), 1.5)


def new_number(plan: Plan) -> None:
    spec = plan.node(lambda spec: beats(spec) and spec.device in LIR_MODELS[1:])
    if spec is not None:
        to = spec.node_id % 120 + 5
        if to not in {each.node_id for each in plan.devices}:
            plan.add(faults.NodeIdChange(spec.node_id, plan.now_s, to), 1.0 + restart_s(spec))


def _only_module(plan: Plan) -> int | None:
    """The module with LSS, where no second one answers the same requests."""
    modules = [spec.node_id for spec in plan.devices if spec.device == "io"]
    return modules[0] if len(modules) == 1 else None


def _taken(plan: Plan) -> set[int]:
    return {spec.node_id for spec in plan.devices}


def _free(plan: Plan) -> int:
    """A number that no device has."""
    return plan.random.choice(sorted(set(range(1, 127)) - _taken(plan)))
