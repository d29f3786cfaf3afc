"""Objects and reactions that several devices share."""

from collections.abc import Callable, Iterable
from functools import partial

from syncline_samples import abort
from syncline_samples.node import Node
from syncline_samples.objects import Object, SdoAbort

SAVE = int.from_bytes(b"save", "little")
LOAD = int.from_bytes(b"load", "little")


def const(index: int, sub: int, kind: str, value: int | bytes) -> Object:
    """An object that nobody can write."""
    return Object(index, sub, kind, "ro", value)


def error_list(depth: int) -> Iterable[Object]:
    """1003h with its entries."""
    yield Object(0x1003, 0, "u8", "rw", 0)
    for sub in range(1, depth + 1):
        yield Object(0x1003, sub, "u32", "ro", 0)


def serve_error_list(node: Node, depth: int, *, abort_beyond_count: bool) -> None:
    """Answer 1003h from the EMCY machine; writing 0 to sub 0 clears it (CiA 301 7.5.2.3)."""
    node.emcy.depth = depth

    def entry(sub: int) -> int:
        if sub <= len(node.emcy.history):
            return node.emcy.history[sub - 1]
        if abort_beyond_count:
            raise SdoAbort(abort.NO_SUB)
        return 0

    def clear(value: int) -> None:
        if value:
            raise SdoAbort(abort.NO_SUB)
        node.emcy.history = []

    node.objects.on_read(0x1003, 0, lambda: len(node.emcy.history))
    node.objects.on_write(0x1003, 0, clear)
    for sub in range(1, depth + 1):
        node.objects.on_read(0x1003, sub, partial(entry, sub))


def serve_storage(node: Node, groups: dict[int, tuple[int, int]]) -> None:
    """Store and restore by 1010h and 1011h; `groups` gives the index range of each sub-index."""
    for sub, (low, high) in groups.items():
        node.objects.on_write(0x1010, sub, _signed(SAVE, node.objects.save, low, high))
        node.objects.on_write(0x1011, sub, _signed(LOAD, node.objects.restore, low, high))


def _signed(
    signature: int, action: Callable[[int, int], None], low: int, high: int
) -> Callable[[int], None]:
    def act(value: int) -> None:
        if value != signature:
            raise SdoAbort(abort.SIGNATURE)
        action(low, high)

    return act


def serve_mapping(node: Node, pdo: int) -> None:
    """Let 1A0xh of a TPDO be written: what is mapped must exist, be readable and fit (CiA 301 7.5.2.38)."""
    index = 0x19FF + pdo
    objects = node.objects

    def entry(value: int) -> None:
        try:
            data = objects.read(value >> 16, value >> 8 & 0xFF)
        except SdoAbort:
            raise SdoAbort(abort.NOT_MAPPABLE) from None
        if 8 * len(data) != value & 0xFF:
            raise SdoAbort(abort.PDO_LENGTH)

    def count(value: int) -> None:
        entries = [objects.number(index, sub) for sub in range(1, value + 1)]
        if not all(entries):
            raise SdoAbort(abort.VALUE_RANGE)
        if sum(each & 0xFF for each in entries) > 64:
            raise SdoAbort(abort.PDO_LENGTH)
        node.tpdos[pdo].build = partial(mapped_pdo, node, pdo)
        node.tpdos.rewritten(value)

    objects.on_write(index, 0, count)
    for sub in range(1, 9):
        objects.on_write(index, sub, entry)


def mapped_pdo(node: Node, pdo: int, t_ns: int) -> tuple[bytes, tuple[int, ...]]:
    """Bytes and values of a TPDO as 1A0xh maps it."""
    objects, index = node.objects, 0x19FF + pdo
    entries = [objects.number(index, sub) for sub in range(1, objects.number(index) + 1)]
    parts = [objects.read(entry >> 16, entry >> 8 & 0xFF) for entry in entries]
    return b"".join(parts), tuple(int.from_bytes(part, "little") for part in parts)
