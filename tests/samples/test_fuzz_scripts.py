"""What the scripts of random scenarios ask for can be told from the bus."""

from random import Random

from syncline_samples import faults
from syncline_samples.fuzz_plan import Plan
from syncline_samples.fuzz_scripts import SCRIPTS
from syncline_samples.machine import DeviceSpec


def test_no_script_asks_a_node_for_its_state_that_tells_none_any_more() -> None:
    """A LIR sends empty heartbeats after a remote frame; a JN2100 goes on as before."""
    for device, told in (("lir-da158a", False), ("jn2100", True)):
        spec = DeviceSpec(5, device, "node", heartbeat_ms=200)
        plan = Plan(Random(1), (spec,), 50_000, 5.0)
        plan.add(faults.RemoteOnHeartbeat(5, plan.now_s), 1.5)
        for script in SCRIPTS:
            script(plan)
        added = {type(fault) for fault in plan.faults}
        asking = {faults.UnknownState, faults.LeavesOperational, faults.PdoOutsideOperational}
        assert (asking <= added) == told
        assert bool(asking & added) == told
