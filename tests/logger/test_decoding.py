"""The live decoder on whatever a bus may carry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_logger.decoding import Decoded, LiveDecoder
from syncline_logger.node_objects import NodeObjects, PdoBinding
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.description import BusDescription
from syncline_schemas.devices.model import emcy_meaning
from syncline_schemas.proto import syncline_pb2

DESCRIPTION = BusDescription.loads(
    "".join(
        f'[node.{node}]\ndevice = "{device}"\n'
        for node, device in enumerate(
            ("lir-da158", "lir-da158a", "lir-ma158k", "lir-918", "jn2100", "haomiao-38"), 1
        )
    )
)

Row = tuple[int, int, int, int, int, bytes]


def decode(*rows: Row, decoder: LiveDecoder | None = None) -> Decoded:
    batch = FrameBatch.from_rows(rows)
    decoder = decoder or LiveDecoder({0: "a", 1: "b"}, DESCRIPTION)
    return decoder.decode(batch, np.arange(len(batch), dtype=np.int64))


def random_rows(seed: int, count: int) -> list[Row]:
    """Frames of all kinds, many of them SDO transfers about mappings, most of them nonsense."""
    rng = np.random.default_rng(seed)
    bases = [0, 0x80, 0x100, 0x180, 0x280, 0x380, 0x580, 0x600, 0x700, 0x7E5]
    rows = []
    for n in range(count):
        can_id = min(int(rng.choice(bases)) + int(rng.integers(0, 9)), 0x7FF)
        data = bytearray(rng.bytes(int(rng.choice([0, 1, 2, 4, 7, 8, 8, 8, 12]))))
        if can_id >= 0x580 and len(data) >= 4 and rng.random() < 0.8:
            data[0] = int(rng.choice([0x2F, 0x23, 0x40, 0x41, 0x43, 0x60, 0xA4, 0xC2, 0x80]))
            data[2] = int(rng.choice([0x10, 0x14, 0x16, 0x18, 0x1A]))
            data[1], data[3] = int(rng.integers(0, 4)), int(rng.integers(0, 4))
        flags = int(rng.choice([0, 0, 0, FrameFlag.REMOTE, FrameFlag.ERROR, FrameFlag.EXTENDED]))
        rows.append((n, int(rng.integers(0, 2)), can_id, flags, len(data), bytes(data)))
    return rows


@given(st.integers(0, 2**32))
@settings(max_examples=60, deadline=None)
def test_nothing_on_a_bus_turns_the_decoder_off(seed: int) -> None:
    decoder = LiveDecoder({0: "a", 1: "b"}, DESCRIPTION)
    for part in range(3):
        decoded = decode(*random_rows(seed + part, 150), decoder=decoder)
        assert [text for _, text in decoded.problems if "is off" in text] == []
        for spec, block in decoded.blocks:
            assert np.all(np.diff(block.log_time_ns) >= 0), spec.topic
            assert block.length.sum() == len(block.payload)


@pytest.mark.parametrize("flag", [FrameFlag.REMOTE, FrameFlag.ERROR, FrameFlag.EXTENDED])
def test_only_standard_data_frames_are_canopen(flag: FrameFlag) -> None:
    assert decode((0, 0, 0x705, int(flag), 1, b"\x05")).blocks == []


def test_a_malformed_message_is_left_out() -> None:
    rows: list[Row] = [
        (0, 0, 0x000, 0, 1, b"\x01"),
        (1, 0, 0x085, 0, 7, bytes(7)),
        (2, 0, 0x705, 0, 2, b"\x05\x05"),
        (3, 0, 0x080, 0, 2, b"\x05\x05"),
        (4, 0, 0x100, 0, 5, bytes(5)),
    ]
    assert decode(*rows).blocks == []


def test_every_byte_and_every_length_of_sync_and_heartbeat() -> None:
    """Read back with protobuf's own decoder; frames that are no such message are left out."""
    rows: list[Row] = []
    for n in range(256):
        rows.append((n, 0, 0x080, 0, 1, bytes([n])))
        rows.append((n, 0, 0x080, 0, 0, b""))
        rows.append((n, 0, 0x080, 0, 3, bytes(3)))
        rows.append((n, 0, 0x705, 0, 1, bytes([n])))
        rows.append((n, 0, 0x705, 0, 2, bytes([n, 0])))
    blocks: dict[str, list[bytes]] = {}
    stamps: dict[str, list[int]] = {}
    for spec, block in decode(*rows).blocks:
        begins = np.cumsum(block.length) - block.length
        for begin, length in zip(begins.tolist(), block.length.tolist(), strict=True):
            payload = block.payload[begin : begin + length].tobytes()
            blocks.setdefault(spec.topic, []).append(payload)
        stamps.setdefault(spec.topic, []).extend(block.publish_time_ns.tolist())
    syncs = [syncline_pb2.Sync.FromString(each) for each in blocks["/canopen/a/sync"]]
    counters = [each.counter if each.HasField("counter") else None for each in syncs]
    assert counters == [each for n in range(256) for each in (n, None)]
    assert stamps["/canopen/a/sync"] == [n for n in range(256) for _ in range(2)]
    beats = [
        syncline_pb2.Heartbeat.FromString(each) for each in blocks["/canopen/a/node5/heartbeat"]
    ]
    assert [(each.state, each.toggle, each.boot_up) for each in beats] == [
        (n & 0x7F, n >> 7, n == 0) for n in range(256)
    ]
    assert stamps["/canopen/a/node5/heartbeat"] == list(range(256))
    names = {n: each.state_name for n, each in enumerate(beats)}
    known = {0: "boot-up", 4: "STOPPED", 5: "OPERATIONAL", 0x7F: "PRE-OPERATIONAL"}
    assert {n: names[n] for n in known} == known
    assert (names[0x85], names[0x33], names[0x80]) == ("OPERATIONAL", "unknown 33h", "INITIALISING")


def test_the_byte_00h_of_a_device_that_answers_so_is_not_called_a_boot_up() -> None:
    """The LIR-MA158K, node 3, sends it in place of its state once it was asked (its sheet)."""
    rows = [(n, 0, 0x700 + node, 0, 1, b"\x00") for n, node in enumerate((3, 5))]
    names = {
        spec.topic: syncline_pb2.Heartbeat.FromString(block.payload.tobytes()).state_name
        for spec, block in decode(*rows).blocks
    }
    assert names == {
        "/canopen/a/node3/heartbeat": "boot-up or no state",
        "/canopen/a/node5/heartbeat": "boot-up",
    }


def test_what_is_off_on_one_bus_goes_on_on_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    from syncline_logger import service_messages

    def fail_for_one_code(device: object, code: int) -> str:
        if code == 0x1234:
            raise RuntimeError("bug")
        return emcy_meaning(None, code)

    monkeypatch.setattr(service_messages, "emcy_meaning", fail_for_one_code)
    decoder = LiveDecoder({0: "a", 1: "b"})
    bad, good = bytes.fromhex("3412010000000000"), bytes.fromhex("3081110000000000")
    first = decode((0, 0, 0x085, 0, 8, bad), (1, 1, 0x085, 0, 8, good), decoder=decoder)
    assert first.problems == [(0, "decoding of /canopen/a/node5/emcy is off: RuntimeError: bug")]
    assert [spec.topic for spec, _ in first.blocks] == ["/canopen/b/node5/emcy"]
    second = decode((2, 0, 0x085, 0, 8, good), (3, 0, 0x086, 0, 8, good), decoder=decoder)
    assert [spec.topic for spec, _ in second.blocks] == ["/canopen/a/node6/emcy"]
    assert second.problems == []


def test_polled_values_that_do_not_change_cost_no_rebinding(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bound: list[NodeObjects] = []

    def note(self: NodeObjects) -> list[PdoBinding]:
        bound.append(self)
        return []

    monkeypatch.setattr(NodeObjects, "bindings", note)
    decoder = LiveDecoder({0: "a"})
    poll: list[Row] = []
    for n in range(50):
        for index in ("0010", "0460"):
            poll.append((n, 0, 0x605, 0, 8, bytes.fromhex(f"40{index}0000000000")))
            poll.append((n, 0, 0x585, 0, 8, bytes.fromhex(f"43{index}0096010200")))
    decode(*poll, decoder=decoder)
    bound.clear()
    decode(*poll, (99, 0, 0x705, 0, 1, b"\x05"), decoder=decoder)
    assert bound == []


def test_a_pdo_that_is_mapped_anew_for_ever_is_given_up() -> None:
    decoder = LiveDecoder({0: "a"})
    rows: list[Row] = []
    for n in range(20):
        for command, answer, sub, value in (
            (0x23, 0x60, 1, 0x20000008 + (n << 16)),
            (0x2F, 0x60, 0, 1),
        ):
            head = bytes([0, 0x1A, sub])
            rows.append((n, 0, 0x605, 0, 8, bytes([command]) + head + value.to_bytes(4, "little")))
            rows.append((n, 0, 0x585, 0, 8, bytes([answer]) + head + bytes(4)))
        rows.append((n, 0, 0x185, 0, 1, b"\x01"))
    decoded = decode(*rows, decoder=decoder)
    topics = {spec.topic for spec, _ in decoded.blocks if "tpdo1" in spec.topic}
    assert len(topics) == 16
    assert [text for _, text in decoded.problems] == [
        "decoding of /canopen/a/node5/tpdo1 is off: ValueError: it was mapped in more than 16 ways"
    ]
