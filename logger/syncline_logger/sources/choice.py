"""Which source reads a bus."""

from dataclasses import replace

from syncline_logger.bus_options import BusOptions
from syncline_logger.source import Source

SOCKETCAN = "socketcan"
SLCAN = "slcan"


def source_of(options: BusOptions) -> Source:
    """The source that reads this bus best on this machine, not yet opened.

    SocketCAN and slcan are read natively; python-can reads all else, and what only python-can can do.
    Raises SourceError where there is no such interface.
    """
    if options.interface == SLCAN:
        return _slcan_source(options)
    if options.interface != SOCKETCAN:
        return _python_can_source(options)
    reason = _why_not_native(options)
    if reason:
        note = f"read by python-can, which counts no frames lost in the kernel: {reason}"
        return _python_can_source(options, note)
    from syncline_logger.sources.socketcan import SocketCanSource

    return SocketCanSource(options)


def _slcan_source(options: BusOptions) -> Source:
    from syncline_logger.sources.slcan import SlcanSource, why_not_native

    reason = why_not_native(options)
    if reason:
        return _python_can_source(options, f"read by python-can, frame by frame: {reason}")
    return SlcanSource(options)


def _why_not_native(options: BusOptions) -> str:
    """What only python-can can do; empty where nothing is."""
    from syncline_logger.sources.socketcan import why_unavailable

    if options.arguments:
        return f"{', '.join(options.arguments)} of --bus-kwargs or --bus is known to it alone"
    if not options.channel:
        return "no interface is named with -c"
    return why_unavailable()


def _python_can_source(options: BusOptions, note: str = "") -> Source:
    from syncline_logger.sources.python_can import PythonCanSource, configured, quiet_python_can

    quiet_python_can()
    options = configured(options)
    if options.interface in (SOCKETCAN, SLCAN) and not note:
        return source_of(options)
    source = PythonCanSource(options)
    source.check_interface()
    if note:
        source.facts = replace(source.facts, notes=(note,))
    return source
