"""Findings on LSS: a node-ID or bit rate that was changed, or not taken (CiA 305)."""

from collections.abc import Iterator
from dataclasses import replace

from syncline_analyzer.findings.bus.lss_back import Back, gone_back, stored
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.folds.bus.lss import LssSetting
from syncline_analyzer.folds.renumbered import Renumbered
from syncline_analyzer.results import Finding
from syncline_schemas.canopen.lss import UNCONFIGURED

_ONE_DEVICE = (
    "both numbers are those of one device: no other node was silent just while the new number was"
    " heard"
)


def _settings(facts: Facts, command: str, *, refused: bool) -> list[LssSetting]:
    return [
        each
        for each in facts.control.lss.settings
        if each.request.command == command and each.refused == refused
    ]


def _node_id_changed(facts: Facts) -> Iterator[Finding]:
    """Node-IDs that a slave took, whether it stored them, and the device that goes on with them."""
    for each in _settings(facts, "configure node-ID", refused=False):
        node = each.request.values.get("node_id", 0)
        given = "no node-ID any more" if node == UNCONFIGURED else f"node-ID {node}"
        moved, store = _moved(facts, each), stored(facts, each)
        took = f"{_whose(facts, each)} was given {given} by LSS"
        if store is None or store.refused:
            took += ", and took it" + (", but refused to store it" if store else "")
        else:
            took += ", took it and stored it"
        if moved is not None:
            took += f"; it is node {node} since it booted{facts.at(moved.boot_ns)}"
        back = next((b for b in gone_back(facts) if b.setting_seq == each.answer.seq), None)
        finding = _finding(
            "lss.node_id_changed",
            "warning" if back is not None and back.unasked else "info",
            each,
            f"{took}.{_again(facts, back) if back is not None else ''}",
            "Somebody, or the master, configured a device.",
            f"Was it meant? The new node-ID must be no other node's{_kept(store)}.",
            None if node == UNCONFIGURED else node,
        )
        proof = [store.request.seq, store.answer.seq] if store else []
        proof += [moved.boot_seq] if moved else []
        proof += [back.boot_seq] if back is not None else []
        assumed = _assumed(moved) if moved is not None else []
        assumed += [_ONE_DEVICE] if back is not None and not back.ordered else []
        yield replace(finding, evidence=[*finding.evidence, *proof], assumed=assumed)


def _assumed(moved: Renumbered) -> list[str]:
    """Why a device is taken for one that nothing names."""
    if moved.known:
        return []
    why = f"the device is taken for node {moved.old}, because this is the only node that was reset"
    why += f" just before node {moved.new} booted and was never heard again; it may be a new device"
    why += f" while node {moved.old} failed: no serial number (1018h:4), and no inquired node-ID, tells"
    return [why]


def _again(facts: Facts, back: Back) -> str:
    """How the device came to have its old number again."""
    if back.ordered:
        return f" It is node {back.node} again since it booted at {facts.moment(back.boot_ns)}."
    text = f" Node {back.left} fell silent at {facts.moment(back.last_ns)}, and node {back.node},"
    text += f" silent while node {back.left} was there, started at {facts.moment(back.boot_ns)}:"
    how = " by itself, or was switched off and on," if back.unasked else ""
    return f"{text} it started anew{how} with its old number, as the new one was not stored."


def _kept(store: LssSetting | None) -> str:
    """What becomes of a node-ID at the next start, to go on in a sentence with."""
    if store is None:
        return ", and is lost at the next start unless it was stored"
    return ", and is lost at the next start: it was not stored" if store.refused else ""


def _moved(facts: Facts, setting: LssSetting) -> Renumbered | None:
    """The device that went on under the new number, where that is proven."""
    proven = (m for m in facts.control.renumbered if m.setting_seq == setting.answer.seq)
    return next(proven, None)


def _whose(facts: Facts, setting: LssSetting) -> str:
    """The device, by the node-ID that it had."""
    moved = _moved(facts, setting)
    before = moved.old if moved else facts.control.lss.node_before(setting)
    if before is None or before == UNCONFIGURED:
        return "A device"
    if moved is not None and not moved.known:
        return f"A device that is taken for {facts.inside(setting.request.bus, before)}"
    return facts.who(setting.request.bus, before)


def _bitrate_changed(facts: Facts) -> Iterator[Finding]:
    """Bit rates that a slave took."""
    for each in _settings(facts, "configure bit timing", refused=False):
        yield _finding(
            "lss.bitrate_changed",
            "info",
            each,
            f"A device was given another bit rate by LSS ({each.request.text}), and took it.",
            "Somebody, or the master, configured a device; it takes effect when it is activated or"
            " at the next start.",
            "All devices of a bus need the same bit rate: was each of them changed?",
        )


def _refused(facts: Facts) -> Iterator[Finding]:
    """Settings that a slave did not take."""
    for command in ("configure node-ID", "configure bit timing", "store configuration"):
        for each in _settings(facts, command, refused=True):
            yield _finding(
                "lss.refused",
                "warning",
                each,
                f'A device did not do what LSS asked it: "{each.request.text}" was answered'
                f' "{each.answer.text}".',
                "The device does not support it, or the value is not allowed.",
                "Look up in the device's manual which LSS services and values it takes.",
            )


def _finding(
    id: str,
    severity: str,
    setting: LssSetting,
    text: str,
    cause: str,
    check_next: str,
    node: int | None = None,
) -> Finding:
    request, answer = setting.request, setting.answer
    return Finding(
        id,
        "warning" if severity == "warning" else "info",
        request.bus,
        node,
        request.t_ns,
        answer.t_ns,
        text,
        cause,
        check_next,
        [request.seq, answer.seq],
    )


_ANSWERED = ("Only where a device answers the request within 2 s.",)
RULES = (
    Rule(
        "lss.node_id_changed",
        "A device was given another node-ID by LSS.",
        "The request and the device's answer; those to store it, and the boot-up under the new one.",
        (
            *_ANSWERED,
            (
                "That it was stored is said where the answered order follows in the same session: no"
                " slave was switched between, and no gap hides it."
            ),
            (
                "The old number is said only where the device told it (inquire node-ID), or where one"
                " node alone is never heard again after a reset between, and the new number begins"
                " with a boot-up within 10 s of it; not after a search for devices without a number, nor"
                " where 1018h or the selection by LSS tell of two devices, or several answered."
            ),
            (
                "A warning where the new number is not heard again and one node alone, silent just while"
                " it was, boots after it without a command: the number was not stored."
            ),
            (
                "That it is this node is said to be assumed where neither it told its number nor 1018h:4"
                " was seen of it twice."
            ),
        ),
        _node_id_changed,
        untimed=True,
    ),
    Rule(
        "lss.bitrate_changed",
        "A device was given another bit rate by LSS.",
        "The request and the device's answer.",
        _ANSWERED,
        _bitrate_changed,
        untimed=True,
    ),
    Rule(
        "lss.refused",
        "A device did not take a node-ID, bit rate or store command of LSS.",
        "The request and the device's answer.",
        (*_ANSWERED, "A search for devices that nobody answers is none."),
        _refused,
        untimed=True,
    ),
)
