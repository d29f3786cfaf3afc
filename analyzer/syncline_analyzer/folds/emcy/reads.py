"""Reads with which a node says that none of its errors is left: 1001h = 0, or an empty 1003h."""

from syncline_analyzer.context import Context
from syncline_analyzer.results import SdoTransfers
from syncline_schemas.devices import quirks
from syncline_schemas.named_tuples import NamedTuple

ERROR_REGISTER = 0x1001
ERROR_FIELD = 0x1003


class NoError(NamedTuple):
    """A read that says "no error".

    `after` is the last frame before it that makes a read of 1003h:0 say less: a write that emptied
    the list, or a 1001h that was not 0. What was raised before that is not known to be over.
    """

    seq: int
    t_ns: int
    after: int
    by_register: bool
    """Of 1001h: tells nothing of an error that set no bit of it."""

    def ends(self, first_seq: int, last_seq: int, register: int) -> bool:
        """Whether it ends an error by the first and last frame that told it, and its register."""
        told = bool(register) if self.by_register else first_seq > self.after
        return told and self.seq > last_seq


def no_error_reads(
    transfers: SdoTransfers, context: Context
) -> dict[tuple[str, int], list[NoError]]:
    """Such reads of each (bus, node), in order of `seq`.

    Where a read of 1001h itself clears it, a 0 tells nothing of the error.
    """
    numbers = {context.bus_name(bus): bus for bus in range(len(context.buses))}
    found: dict[tuple[str, int], list[NoError]] = {}
    spoiled: dict[tuple[str, int], int] = {}
    wanted = ((ERROR_REGISTER, 0), (ERROR_FIELD, 0))
    for row in transfers.ok.of_objects(lambda of: (of.index, of.sub or 0) in wanted):
        key = row.bus, row.node
        if row.direction == "upload" and not row.data:
            continue
        by_register = row.index == ERROR_REGISTER
        if row.direction == "download" or (by_register and row.data[0]):
            spoiled[key] = row.seq
            continue
        device = context.shadow.device(numbers.get(row.bus, 0), row.node)
        if not row.data[0] and (ERROR_REGISTER, 0) not in quirks(device).clear_on_read:
            read = NoError(row.seq, row.end_ns, spoiled.get(key, -1), by_register)
            found.setdefault(key, []).append(read)
    return found
