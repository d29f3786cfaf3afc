"""Why a node is taken for a device, what it looks like where nobody says, and wrong assignments."""

from itertools import pairwise

import pytest

from tests.analyzer.traps.script import Script, Told, little, says

L158, JN2100 = 0x3835314C, 0x3132_4E4A


def lir_name(script: Script) -> Script:
    return script.read(10, 0x1008, 0, L158)


def looking_like_jn2100(script: Script) -> Script:
    """Sheet ifm-jn2100, 1: after each SYNC 180h+id DLC 4, 280h+id DLC 8, 380h+id DLC 8."""
    script.heartbeat(0, 10_000, period=1000).sync(3, 10_000)
    for base, bits, after in ((0x180, 16, 1), (0x280, 32, 2), (0x380, 32, 3)):
        script.pdo(3 + after, 10_000, 20, lambda k: (k % 50, 7), base=base, bits=bits)
    return script


def looking_like_a_lir(script: Script, first: int = 1000) -> Script:
    """Sheet skbis-lir-da158, 1: 180h+id DLC 4 every 515 ms, 280h+id DLC 4 on every 2nd SYNC."""
    script.heartbeat(0, 20_000, period=1000).sync(3, 20_000)
    script.pdo(100, 20_000, 515, lambda k: first + k)
    return script.pdo(4, 20_000, 40, lambda k: first + k // 13, base=0x280)


def test_the_user_s_word_is_the_reason_and_what_was_seen_agrees() -> None:
    script = lir_name(Script("lir-da158a", 5).heartbeat(0, 1000)).read(20, 0x1000, 0, 0x10196)
    row = script.told().row()
    assert (row.device, row.device_source) == ("lir-da158a", "bus description")
    assert says(row.device_reason, "bus description", '1008h = "L158"', "frame", "agrees")


@pytest.mark.parametrize(
    ("index", "size", "value", "device"),
    [
        (0x6200, 2, 515, "lir-da158"),
        (0x6200, None, None, "lir-da158a"),
        (0x1015, None, None, "lir-da158"),
        (0x1015, 2, 0, "lir-da158a"),
        (0x1010, 1, 3, "lir-da158"),
        (0x1010, 1, 1, "lir-da158a"),
    ],
)
def test_old_and_new_l158_are_told_apart_with_the_reason(
    index: int, size: int | None, value: int | None, device: str
) -> None:
    """Sheet skbis-lir-canopen, trap 20."""
    script = lir_name(Script(None, 5).heartbeat(0, 1000))
    if value is None or size is None:
        script.read(30, index, 0, abort=0x06020000)
    else:
        script.read(30, index, 0, value, size=size)
    row = script.told().row()
    assert (row.device, row.device_source) == (device, "objects")
    assert says(row.device_reason, '1008h = "L158"', f"{index:04X}h")
    assert ("does not exist" in row.device_reason) is (value is None)


def test_l158_alone_is_either_and_says_what_would_tell() -> None:
    row = lir_name(Script(None, 5).heartbeat(0, 1000)).told().row()
    assert row.device == "lir-da158 or lir-da158a"
    assert says(row.device_reason, "fits lir-da158 and lir-da158a", "6200h", "1015h", "1010h")


def test_of_an_unknown_maker_the_profile_is_told() -> None:
    row = Script(None, 5).heartbeat(0, 1000).read(10, 0x1000, 0, 0x00020196).told().row()
    assert (row.device, row.device_source) == (None, None)
    assert says(row.device_reason, "1000h = 00020196h", "CiA 406 encoder")
    other = Script(None, 5).heartbeat(0, 1000).read(10, 0x1000, 0, 0x00030191).told().row()
    assert says(other.device_reason, "1000h = 00030191h", "no device of the catalogue")


def test_without_a_single_answer_there_is_no_reason() -> None:
    row = Script(None, 5).heartbeat(0, 1000).told().row()
    assert (row.device_reason, row.device_guess) == ("", [])


@pytest.mark.triggers("device.looks_like")
def test_pdos_like_the_factory_settings_of_a_jn2100_are_a_hint() -> None:
    told = looking_like_jn2100(Script(None, 17)).told()
    row = told.row()
    assert (row.device, row.device_guess) == (None, ["jn2100"])
    found = told.finding("device.looks_like")
    assert found.severity == "info"
    assert says(found.text, "191h has 4 bytes", "291h has 8 bytes", "391h", "every SYNC")
    assert says(found.check_next, "--device 17=jn2100")
    assert told.traced() == []


@pytest.mark.triggers("device.looks_like")
def test_pdos_like_those_of_a_lir_fit_all_of_them() -> None:
    told = looking_like_a_lir(Script(None, 5)).told()
    names = ["lir-918", "lir-da158", "lir-da158a", "lir-ma158k"]
    assert told.row().device_guess == names
    assert says(told.finding("device.looks_like").text, "every 515 ms", "every 2nd SYNC")


@pytest.mark.near_miss("device.looks_like")
@pytest.mark.parametrize(
    "script",
    [
        Script(None, 5).heartbeat(0, 9000).pdo(5, 9000, 100, lambda k: k),
        Script(None, 5).heartbeat(0, 9000).pdo(5, 9000, 515, lambda k: (k, 1), bits=32),
        looking_like_jn2100(Script(None, 10)).every(9, 9000, 20, "48A#00"),
        looking_like_a_lir(Script("lir-da158", 5)),
        looking_like_a_lir(Script(None, 5)).read(10, 0x1000, 0, 0x00020196),
    ],
    ids=["a round timer", "other length", "one PDO more", "named", "its profile was read"],
)
def test_what_many_devices_send_is_no_hint(script: Script) -> None:
    told = script.told()
    assert "device.looks_like" not in told.ids
    assert told.row().device_guess == []


def maga(script: Script) -> Script:
    """1008h = "MAGA", a name that rebrands share (sheet haomiao-38, trap 14)."""
    script.heartbeat(0, 5000).pdo(15, 5000, 100, lambda k: 1000 + 40 * k)
    return script.read(10, 0x1008, 0, 0x4147414D)


@pytest.mark.triggers("device.looks_like")
def test_a_name_that_several_makers_use_is_a_hint_and_says_how_to_get_the_trace() -> None:
    told = maga(Script(None, 5)).read(20, 0x1000, 0, 0x00020196).told()
    assert (told.row().device, told.row().device_guess) == (None, ["haomiao-38"])
    found = told.finding("device.looks_like")
    assert found.severity == "info"
    assert len(found.evidence) == 2
    assert says(found.text, '1008h = "MAGA"', "haomiao-38", "3000h or 3001h would tell")
    assert says(found.check_next, "--device 5=haomiao-38")
    assert told.traced() == []
    named = maga(Script("haomiao-38", 5)).told()
    assert named.traced() == [0x6004]
    assert "device.looks_like" not in named.ids


@pytest.mark.triggers("device.looks_like")
def test_an_object_of_the_makers_own_and_the_kind_of_device_are_a_hint() -> None:
    script = Script(None, 5).heartbeat(0, 1000).read(10, 0x1000, 0, 0x00020196)
    told = script.read(20, 0x3001, 0, 3, size=1).told()
    assert told.row().device_guess == ["haomiao-38"]
    assert says(told.finding("device.looks_like").text, "3001h = 3", "1008h or 3000h would tell")


@pytest.mark.near_miss("device.looks_like")
def test_what_the_weak_name_is_refuted_by() -> None:
    refused = maga(Script(None, 5))
    for at, index in ((20, 0x3000), (30, 0x3001)):
        refused.read(at, index, abort=0x06020000)
    other_kind = maga(Script(None, 5)).read(20, 0x1000, 0, 0x00030191)
    common = Script(None, 5).heartbeat(0, 1000).read(10, 0x1000, 0, 0x00010196)
    for script in (refused, other_kind, common.read(20, 0x6200, 0, 20, size=2)):
        told = script.told()
        assert told.row().device_guess == []
        assert "device.looks_like" not in told.ids


def type_0(script: Script) -> Script:
    """Sheet skbis-lir-canopen, trap 6: the new generation sends with type 0, the old is off."""
    lir_name(script.heartbeat(0, 9000).sync(3, 9000)).read(20, 0x1800, 2, 0, size=1)
    return script.pdo(1004, 9000, 400, lambda k: 50 * k)


@pytest.mark.triggers("device.looks_like")
def test_of_old_and_new_l158_the_pattern_of_a_pdo_may_tell() -> None:
    told = type_0(Script(None, 5)).told()
    row = told.row()
    assert (row.device, row.device_guess) == ("lir-da158 or lir-da158a", ["lir-da158a"])
    found = told.finding("device.looks_like")
    assert says(found.text, "more likely a lir-da158a", "185h is sent though", "type is 0")
    assert told.traced() == [0x6004]


@pytest.mark.near_miss("device.looks_like")
def test_a_pdo_that_both_l158_send_tells_nothing() -> None:
    script = lir_name(Script(None, 5)).heartbeat(0, 9000).sync(3, 9000)
    told = script.read(20, 0x1800, 2, 1, size=1).pdo(1004, 9000, 20, lambda k: 50 * k).told()
    assert told.row().device_guess == []
    assert "device.looks_like" not in told.ids
    proven = type_0(Script(None, 5)).read(30, 0x1015, 0, 0, size=2).told()
    assert proven.row().device == "lir-da158a"
    assert "device.looks_like" not in proven.ids


@pytest.mark.triggers("device.position_not_shown")
@pytest.mark.parametrize(
    ("kind", "words"), [(0x00020196, "CiA 406 encoder"), (0x0002019A, "CiA 410 inclinometer")]
)
def test_an_encoder_whose_pdos_nobody_explains(kind: int, words: str) -> None:
    script = Script(None, 5).heartbeat(0, 5000).read(10, 0x1000, 0, kind)
    told = script.pdo(15, 5000, 100, lambda k: 1000 + 40 * k).told()
    found = told.finding("device.position_not_shown")
    assert (found.severity, len(found.evidence)) == ("info", 1)
    assert says(found.text, words, "185h", "not shown")
    assert says(found.check_next, "--device 5=FILE.eds")


@pytest.mark.near_miss("device.position_not_shown")
def test_what_is_shown_or_no_encoder_is_not_said_to_be_missing() -> None:
    def script(kind: int, device: str | None = None) -> Script:
        encoder = Script(device, 5).heartbeat(0, 5000).read(10, 0x1000, 0, kind)
        return encoder.pdo(55, 5000, 100, lambda k: 1000 + 40 * k)

    mapped = script(0x00020196).read(20, 0x1800, 1, 0x185).read(30, 0x1A00, 0, 1, size=1)
    mapped.read(40, 0x1A00, 1, 0x60040020)
    polled = script(0x00020196).read(20, 0x6004, 0, 1000).read(30, 0x6004, 0, 1040)
    for each in (mapped, polled, script(0x00030191), script(0x00020196, "haomiao-38")):
        assert "device.position_not_shown" not in each.told().ids


def wrong(told: Told) -> str:
    return told.finding("device.wrong_device").text


@pytest.mark.triggers("device.wrong_device")
def test_an_encoder_that_was_named_an_inclinometer() -> None:
    """Its TPDO2 has 4 bytes where a JN2100 maps 8 for good, and its angles are impossible."""
    told = looking_like_a_lir(Script("jn2100", 5), first=60_000).told()
    found = told.finding("device.wrong_device")
    assert len(found.evidence) >= 2
    assert found.severity == "warning"
    assert says(found.text, "bus description", "TPDO2 (285h) has 4 bytes and not 8", "impossible")


@pytest.mark.triggers("device.wrong_device")
def test_an_inclinometer_that_was_named_an_encoder() -> None:
    text = wrong(looking_like_jn2100(Script("lir-da158", 5)).told())
    assert says(text, "TPDO2 (285h) has 8 bytes and not 4", "385h, a TPDO3 that it does not have")


@pytest.mark.triggers("device.wrong_device")
def test_a_node_that_calls_itself_something_else() -> None:
    script = lir_name(Script("jn2100", 5).heartbeat(0, 1000)).read(20, 0x1000, 0, 0x10196)
    found = script.read(30, 0x6010, abort=0x06020000).told().finding("device.wrong_device")
    assert says(found.text, 'calls itself "L158"', "CiA 406", "CiA 410", "6010h, its position")
    assert len(found.evidence) == 3
    better = lir_name(Script("jn2100", 5).heartbeat(0, 1000)).read(30, 0x1015, 0, 0, size=2).told()
    assert says(better.finding("device.wrong_device").check_next, "Name it lir-da158a")


@pytest.mark.triggers("device.wrong_device")
def test_the_new_l158_that_was_named_the_old_one() -> None:
    script = lir_name(Script("lir-da158", 5).heartbeat(0, 1000))
    told = script.read(30, 0x6200, abort=0x06020000).told()
    assert says(wrong(told), "6200h does not exist, other than in that device")
    assert says(told.finding("device.wrong_device").cause, "LIR-DA158A")


def test_impossible_values_alone_may_be_a_setting() -> None:
    """A JN2100 whose resolution is finer than the factory value: an info, no accusation."""
    script = Script("jn2100", 10).heartbeat(0, 10_000, period=1000).sync(3, 10_000)
    script.pdo(5, 10_000, 20, lambda k: (20_000 + k, 20_000), bits=16)
    found = script.told().finding("device.wrong_device")
    assert found.severity == "info"
    assert says(found.cause, "settings were changed before")


@pytest.mark.near_miss("device.wrong_device")
def test_right_names_are_left_in_peace() -> None:
    for script in (
        looking_like_jn2100(Script("jn2100", 10)).read(10, 0x1000, 0, 0x0004019A),
        looking_like_a_lir(Script("lir-da158a", 5)).read(10, 0x1000, 0, 0x10196),
        lir_name(looking_like_a_lir(Script("lir-da158", 5))).read(30, 0x1018, 2, 0x009E000D),
    ):
        assert "device.wrong_device" not in script.told().ids


@pytest.mark.near_miss("device.wrong_device")
def test_another_mapping_that_the_node_acknowledged_is_its_own() -> None:
    """Sheet haomiao-38, trap 6: PDOs can be remapped, then another length is legal."""
    script = Script("haomiao-38", 1).heartbeat(0, 5000)
    script.write(10, 0x1A00, 0, 0, size=1).write(20, 0x1A00, 1, 0x60040020)
    script.write(30, 0x1A00, 2, 0x65030010).write(40, 0x1A00, 0, 2, size=1)
    told = script.every(500, 5000, 100, f"181#{little(1000)}0000").told()
    assert "device.wrong_device" not in told.ids


@pytest.mark.near_miss("device.wrong_device")
def test_a_fourth_pdo_of_another_firmware_is_no_contradiction() -> None:
    """Sheet ifm-jn2100, section 11: firmware 2.2.0 has one on 480h + id."""
    script = looking_like_jn2100(Script("jn2100", 10)).every(9, 9000, 20, "48A#000000000000")
    assert "device.wrong_device" not in script.told().ids


def test_a_device_that_the_node_itself_named_is_not_doubted() -> None:
    script = looking_like_a_lir(lir_name(Script(None, 5)).read(30, 0x1015, 0, 0, size=2))
    assert "device.wrong_device" not in script.told().ids


def test_the_reason_is_in_the_json() -> None:
    import json

    script = lir_name(Script(None, 5).heartbeat(0, 1000)).read(30, 0x1015, 0, 0, size=2)
    (node,) = json.loads(script.told().json)["nodes"]
    assert node["device_source"] == "objects"
    assert "1015h" in node["device_reason"]
    assert all(a <= b for a, b in pairwise(node["device_guess"]))


def test_the_summary_says_which_device_it_is_and_why() -> None:
    script = lir_name(Script(None, 5).heartbeat(0, 1000)).read(30, 0x1015, 0, 0, size=2)
    assert 'lir-da158a: 1008h = "L158"' in script.told().summary
