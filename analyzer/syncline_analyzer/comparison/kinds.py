"""The kinds of differences, the weightiest first, and why each matters to a service engineer."""

from typing import Final

KINDS: Final[dict[str, str]] = {
    "bus.silent": "Nothing at all was heard where traffic was: cable, supply of the whole bus, or the adapter.",
    "bus.bitrate": "Devices at another bit rate cannot talk to one another.",
    "node.missing": "A device that belongs to the machine was not heard: supply, cable, node id.",
    "node.identity": "It is another device or model under the same node id: scales and objects may be others.",
    "sync.gone": "Without SYNC no synchronous PDO comes.",
    "pdo.gone": "Whoever uses these values works with old ones or none.",
    "node.state": "A device in another state sends no PDOs or takes no commands.",
    "angle.setting": "The same position gives another number: every angle of this device means something else.",
    "finding.new": "A rule found a fault that the healthy capture does not have.",
    "emcy.new": "The device reports an error that it did not report when the machine was healthy.",
    "emcy.more": "The device reports this error more often than when the machine was healthy.",
    "node.serial": "The device was exchanged: settings and zero point may not have been carried over.",
    "node.firmware": "Another firmware may behave differently with the same settings.",
    "pdo.mapping": "The bytes of the PDO mean something else to whoever reads them.",
    "pdo.length": "Receivers drop or misread a PDO of another length (CiA 301: EMCY 8210h).",
    "pdo.type": "The PDO is sent at other occasions than the receivers expect.",
    "sync.period": "The cycle of the machine is another one: control loops and time-outs depend on it.",
    "period": "Time-outs of receivers are laid out for the period of the healthy machine.",
    "error_control.gone": "Nobody notices any more when this node fails.",
    "error_control.new": "The supervision of this node is another one.",
    "object": "A parameter of the device is not what it was on the healthy machine.",
    "error_frames.more": "Error frames are disturbances of the wires: termination, cable, EMC, a faulty node.",
    "error_frames.fewer": "Fewer disturbances than on the golden capture.",
    "sdo.new_failure": "A request that the device answered on the healthy machine fails now.",
    "sdo.more_failures": "Requests to the device fail more often.",
    "sdo.slower": "The device takes longer to answer: it is busy, or another firmware.",
    "pdo.missed": "The PDO answers fewer SYNCs: the device is too slow, or the bus too full.",
    "pdo.response": "Values are older when they arrive: the device got slower, or waits for the bus.",
    "jitter": "Times scatter more than on the healthy machine: a master under load, a fuller bus.",
    "extreme": "A single period or answer lies far outside of what the healthy machine shows.",
    "bus.load": "Low-priority frames wait longer on a fuller bus; an emptier one misses traffic.",
    "node.boot_time": "The device takes another time to start: firmware, supply, or a self test that fails.",
    "node.new": "A device answers that the healthy machine does not have.",
    "node.boot_ups": "The device started more often than on the healthy machine.",
    "pdo.new": "A PDO is sent that the healthy machine does not have.",
    "sync.new": "There is a SYNC that the healthy machine does not have.",
    "angle.noise": "More noise at rest points to vibration, a loose mount or a failing sensor.",
    "angle.range": "The axis moved where it did not move on the healthy machine.",
    "identifier.new": "Somebody sends what nobody sent on the healthy machine.",
    "identifier.gone": "Somebody does not send any more.",
    "finding.more": "It happens more often than on the golden capture.",
    "finding.gone": "The golden capture has this, the capture does not.",
    "emcy.gone": "The golden capture has this, the capture does not.",
}  # fmt: skip
"""Why a difference of each kind matters."""

ORDER: Final[dict[str, int]] = {kind: place for place, kind in enumerate(KINDS)}
"""Rank of the kinds within one severity."""
