"""What a user should know of a SocketCAN interface, in words."""

from syncline_logger.bus_options import BusOptions
from syncline_logger.sources.link_wire import CanLink

FRAME_BYTES = 760
"""What a waiting frame takes of the receive buffer, with the kernel's bookkeeping."""
_ANY_BITRATE = 500_000


def set_up_command(name: str, bitrate: int | None) -> str:
    """The command that brings the interface up.

    >>> set_up_command("can0", None)
    'ip link set can0 up type can bitrate 500000'
    """
    return f"ip link set {name} up type can bitrate {bitrate or _ANY_BITRATE}"


def what_is_missing(name: str, bitrate: int | None) -> str:
    """Said where there is no such interface."""
    return (
        f"there is no interface '{name}'; 'ip link' lists what there is. Plug the adapter in, load"
        f" its driver, then '{set_up_command(name, bitrate)}'"
    )


def what_is_down(link: CanLink, bitrate: int | None) -> str:
    """Said where the interface is there but down."""
    if link.kind == "vcan":
        return f"the interface is down; 'ip link set {link.name} up'"
    command = set_up_command(link.name, bitrate or link.bitrate)
    return f"the interface is down; '{command}'"


def interface_notes(
    link: CanLink, options: BusOptions, buffer_bytes: int, wanted_bytes: int, before: int | None
) -> tuple[str, ...]:
    """Sentences on an opened interface.

    before: bit rate when it was opened the last time.
    """
    return tuple(
        note
        for note in (
            _bitrate_note(link, options),
            _changed_bitrate_note(link, before),
            _listen_only_note(link, options),
            _fd_note(link, options),
            _buffer_note(buffer_bytes, wanted_bytes),
        )
        if note
    )


def _bitrate_note(link: CanLink, options: BusOptions) -> str:
    if not link.bitrate or not options.bitrate or link.bitrate == options.bitrate:
        return ""
    return (
        f"{link.name} is set to {link.bitrate} bit/s, not to the {options.bitrate} bit/s that were"
        f" told; the recorder changes nothing: 'ip link set {link.name} down', then"
        f" '{set_up_command(link.name, options.bitrate)}'"
    )


def _changed_bitrate_note(link: CanLink, before: int | None) -> str:
    if not before or not link.bitrate or before == link.bitrate:
        return ""
    return f"{link.name} was set from {before} to {link.bitrate} bit/s"


def _listen_only_note(link: CanLink, options: BusOptions) -> str:
    if link.listen_only is None or link.listen_only or options.acknowledge:
        return ""
    if link.can_listen_only is False:
        return f"{link.name} acknowledges frames: its controller has no listen-only mode"
    return (
        f"{link.name} acknowledges frames; where other nodes do, let it only listen: 'ip link set"
        f" {link.name} down', then '{set_up_command(link.name, link.bitrate)} listen-only on'"
    )


def _fd_note(link: CanLink, options: BusOptions) -> str:
    if not options.fd or link.takes_fd:
        return ""
    return f"{link.name} is not set up for CAN FD: frames of CAN FD are not heard"


def _buffer_note(buffer_bytes: int, wanted_bytes: int) -> str:
    if buffer_bytes >= wanted_bytes:
        return ""
    return (
        f"the kernel's receive buffer holds about {buffer_bytes // FRAME_BYTES} frames instead of"
        f" {wanted_bytes // FRAME_BYTES}: 'sysctl net.core.rmem_max={wanted_bytes // 2}', or run"
        " the recorder with CAP_NET_ADMIN"
    )
