"""A simulated CANopen node: its NMT life, SDO server, and the parts that hang on them."""

from collections.abc import Callable
from enum import StrEnum
from functools import partial
from typing import Any

from syncline_samples.bus import Frame, Listener
from syncline_samples.emcy import EmcyMachine
from syncline_samples.error_control import ErrorControl
from syncline_samples.objects import Object, ObjectDictionary
from syncline_samples.sdo_server import SdoServer
from syncline_samples.tpdo import Tpdo, TpdoSet
from syncline_samples.truth import BootUpTruth, StateTruth
from syncline_samples.world import MS, Delay, World


class State(StrEnum):
    """NMT state of a simulated node, OFF without power."""

    OFF = "OFF"
    INITIALISING = "INITIALISING"
    PRE_OPERATIONAL = "PRE-OPERATIONAL"
    OPERATIONAL = "OPERATIONAL"
    STOPPED = "STOPPED"


STATE_BYTE = {
    State.INITIALISING: 0x00,
    State.STOPPED: 0x04,
    State.OPERATIONAL: 0x05,
    State.PRE_OPERATIONAL: 0x7F,
}
_COMMANDED = {0x01: State.OPERATIONAL, 0x02: State.STOPPED, 0x80: State.PRE_OPERATIONAL}
_RESETS = (0x81, 0x82)


class Node:
    """A node with power, an object dictionary and services; the devices derive from it.

    Attributes:
        life: grows with each restart and power cut; what was scheduled in another life is void.
        connected: False while the node is cut off the bus; it goes on living.
        ignore_commands: how many NMT commands the node will overlook.
        mute_sdo: the SDO server does not answer.
        sdo_delays_ns: how much longer than usual the next SDO answers take, one entry per answer.
        sdo_timeout_ns: the server aborts a transfer that the client does not continue; 0 for never.
        quiet_after_boot_up: the silence after an NMT reset comes after the boot-up frame, for SDO.
        told: the truth tells of its NMT states; not so for the twin of another node.
    """

    boot_ns = 250 * MS
    reset_quiet_ns = 0
    """Silence after an NMT reset, before the boot-up frame."""
    answer_delay = Delay(400_000, 300_000)
    """From an SDO request to its answer."""
    response_delay = Delay(300_000, 60_000)
    """From a SYNC to the PDO that answers it."""

    def __init__(
        self,
        world: World,
        node_id: int,
        objects: list[Object],
        *,
        drift_ppm: int = 0,
        **sdo: bool,
    ) -> None:
        self.world = world
        self.node_id = node_id
        self.drift_ppm = drift_ppm
        self.state = State.OFF
        self.life = 0
        self.connected = True
        self.ignore_commands = 0
        self.mute_sdo = False
        self.sdo_delays_ns: list[int] = []
        self.sdo_timeout_ns = 0
        self._sdo_free_ns = 0
        self._sdo_requests = 0
        self.told = True
        self._since_ns = 0
        self._heard: dict[str, tuple[int, Listener]] = {}
        self.objects = ObjectDictionary(objects)
        self.sdo = SdoServer(self.objects, **sdo)
        self._answer_id = 0x580 + node_id
        self._quiet_until_ns = 0
        self.quiet_after_boot_up = False
        self.emcy = EmcyMachine(self)
        self.error_control = ErrorControl(self)
        self.tpdos = TpdoSet(self, self.make_tpdos(), self.response_delay)
        self.hear("NMT", 0x000, self._on_nmt)
        self._open_channel()

    number_object = 0
    """Index of the object that holds the node id, which counts from the next reset on."""

    def hear(self, service: str, can_id: int, listener: Listener) -> None:
        """Listen to the identifier of a service, instead of the one it had before."""
        before = self._heard.get(service)
        if before is None or before[0] != can_id:
            if before is not None:
                self.world.bus.unlisten(*before)
            self._heard[service] = can_id, listener
            self.world.bus.listen(can_id, listener)

    def _open_channel(self) -> None:
        """The identifiers of the SDO server: 1200h where it can be written."""
        request = self.objects.number(0x1200, 1) or 0x600 + self.node_id
        self._answer_id = self.objects.number(0x1200, 2) or 0x580 + self.node_id
        self.hear("SDO", request, self._on_sdo)

    def _renumber(self) -> None:
        """Take the node id of the object dictionary, with the identifiers that hang on it."""
        number = self.objects.number(self.number_object) if self.number_object else 0
        if number in (0, self.node_id):
            return
        self.objects.renumber(self.node_id, number)
        self.node_id = number
        self.objects.reload()
        self.error_control.attach()

    def make_tpdos(self) -> list[Tpdo]:
        """The TPDOs of the device."""
        return []

    def boot_up_byte(self) -> int:
        """State byte of the boot-up frame."""
        return 0x00

    def emcy_bytes(self, code: int, register: int, alarms: int, warnings: int) -> bytes:
        """The eight bytes of an EMCY in the device's layout."""
        return code.to_bytes(2, "little") + bytes([register, 0, 0, 0, 0, 0])

    def guard_lost(self) -> None:
        """React to a master that stopped guarding; the EMCY has been sent."""

    def restarted(self) -> None:
        """Take over what is read once at start-up."""

    @property
    def now_ns(self) -> int:
        """Virtual time."""
        return self.world.simulation.now_ns

    @property
    def awake(self) -> bool:
        """Whether the node takes part in the traffic at all."""
        return self.connected and self.state not in (State.OFF, State.INITIALISING)

    def after(self, delay_ns: int, action: Callable[..., None], *args: Any) -> None:
        """Do something later in the same life."""
        later_ns = self.now_ns + delay_ns + delay_ns * self.drift_ppm // 1_000_000
        self.world.simulation.at(later_ns, self._if_same_life, self.life, action, args)

    def _if_same_life(self, life: int, action: Callable[..., None], args: tuple[Any, ...]) -> None:
        if life == self.life:
            action(*args)

    def send(self, frame: Frame, on_sent: Callable[[int], None] | None = None) -> None:
        """Queue a frame, unless the node is cut off."""
        if self.connected:
            self.world.bus.send(frame, self, on_sent)

    def power_on(self) -> None:
        """Start up as after a power cycle."""
        self.restart(self.boot_ns, commanded=False)

    def power_off(self) -> None:
        """Lose power at once."""
        self.life += 1
        self.world.bus.withdraw(self)
        self.enter(State.OFF)

    def restart(self, delay_ns: int, *, commanded: bool) -> None:
        """Initialise, and show up with a boot-up frame after a delay."""
        self.life += 1
        self.world.bus.withdraw(self)
        self.enter(State.INITIALISING)
        self.emcy.reset()
        self.objects.reload()
        self._renumber()
        self.sdo.reset()
        self._sdo_free_ns = self._quiet_until_ns = 0
        self._open_channel()
        self.restarted()
        self.tpdos.configure()
        if commanded and self.quiet_after_boot_up:
            self._quiet_until_ns = self.now_ns + self.reset_quiet_ns
            delay_ns = min(delay_ns, self.boot_ns)
        self.after(delay_ns, self._boot_up, commanded)

    def _boot_up(self, commanded: bool) -> None:
        byte = self.boot_up_byte()
        frame = Frame(0x700 + self.node_id, bytes([byte]))
        self.send(frame, partial(self._booted, self.life, byte, commanded))
        if not self.connected:
            self._ready(self.life)

    def _booted(self, life: int, byte: int, commanded: bool, t_ns: int) -> None:
        boot_up = BootUpTruth(self.world.utc_ns(t_ns), self.node_id, byte, commanded)
        self.world.truth.boot_ups.append(boot_up)
        self._ready(life)

    def _ready(self, life: int) -> None:
        if life == self.life:
            self.enter(State.PRE_OPERATIONAL)
            self.error_control.start()

    def enter(self, state: State) -> None:
        """Change the NMT state."""
        if state is self.state:
            return
        self._close_interval()
        was_operational = self.state is State.OPERATIONAL
        self.state = state
        if state is State.OPERATIONAL:
            self.tpdos.start()
        elif was_operational:
            self.tpdos.stop()

    def _close_interval(self) -> None:
        if self.told and self.now_ns > self._since_ns:
            start_ns, end_ns = self.world.utc_ns(self._since_ns), self.world.utc_ns(self.now_ns)
            interval = StateTruth(self.node_id, self.state.value, start_ns, end_ns)
            self.world.truth.states.append(interval)
        self._since_ns = self.now_ns

    def finish(self) -> None:
        """Close the last interval of the truth, and what the node has open beside it."""
        self._close_interval()
        self.emcy.finish()

    def _on_nmt(self, frame: Frame, t_ns: int) -> None:
        data = frame.data
        if not self.awake or len(data) != 2 or data[1] not in (0, self.node_id):
            return
        if self.ignore_commands:
            self.ignore_commands -= 1
        elif data[0] in _RESETS:
            self.restart(self.reset_quiet_ns or self.boot_ns, commanded=True)
        elif data[0] in _COMMANDED:
            self.enter(_COMMANDED[data[0]])

    def _on_sdo(self, frame: Frame, t_ns: int) -> None:
        ready = self.awake and self.state is not State.STOPPED and not self.mute_sdo
        if not ready or frame.remote_dlc is not None or not frame.data:
            return
        if t_ns < self._quiet_until_ns:
            return
        delay_ns = self.answer_delay.draw(self.world.rng)
        if self.sdo_delays_ns:
            delay_ns += self.sdo_delays_ns.pop(0)
        self._sdo_free_ns = max(self._sdo_free_ns, self.now_ns + delay_ns)
        self.after(self._sdo_free_ns - self.now_ns, self._answer, frame.data)

    def _answer(self, request: bytes) -> None:
        if self.state is State.STOPPED:
            return
        self._send_sdo(self.sdo.answer(request))
        self._sdo_requests += 1
        if self.sdo_timeout_ns and self.sdo.busy:
            self.after(self.sdo_timeout_ns, self._check_sdo, self._sdo_requests)

    def _check_sdo(self, requests: int) -> None:
        if requests == self._sdo_requests and self.sdo.busy and self.awake:
            self._send_sdo([self.sdo.give_up()])

    def _send_sdo(self, answers: list[bytes]) -> None:
        for answer in answers:
            self.send(Frame(self._answer_id, answer))
