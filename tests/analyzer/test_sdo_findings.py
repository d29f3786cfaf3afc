"""Each rule on SDO: a case that triggers it, and a near miss that does not."""

from binascii import crc_hqx

import pytest

from syncline_analyzer.results import BusSilenceRow, Finding
from syncline_schemas.batch import Gap
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import load_device
from tests.analyzer.control_runs import MS, Row, Run, frame, run
from tests.analyzer.test_nmt_fold import heartbeats, ordered
from tests.analyzer.test_sdo_fold import sdo

READ = "40 0010 00 00000000"
VALUE = "43 0010 00 96010100"
OTHER = heartbeats(0, 4000, node=9)
ALIVE = ordered(heartbeats(0, 4000), OTHER)


def one(result: Run, rule: str) -> Finding:
    """The only SDO finding, with its evidence, cause and next step."""
    (finding,) = [found for found in result.findings() if found.id.startswith("sdo.")]
    assert finding.id == rule
    assert finding.evidence
    assert finding.text.endswith(".")
    assert finding.cause
    assert finding.check_next
    return finding


def silent(result: Run) -> bool:
    return not [found for found in result.findings() if found.id.startswith("sdo.")]


def every(
    count: int, step_ms: float, *exchange: tuple[str, str], start_ms: float = 10
) -> list[Row]:
    """The same exchange again and again."""
    return [
        row for turn in range(count) for row in sdo(*exchange, start_ms=start_ms + turn * step_ms)
    ]


@pytest.mark.triggers("sdo.abort")
def test_a_refused_write_is_a_warning_in_words() -> None:
    refused = sdo((">", "2B 1710 00 FA000000"), ("<", "80 1710 00 02000106"), start_ms=5)
    finding = one(run(*ordered(refused, ALIVE)), "sdo.abort")
    assert finding.severity == "warning"
    assert "read-only" in finding.text


@pytest.mark.near_miss("sdo.abort")
def test_an_accepted_write_is_no_finding_and_a_search_a_note() -> None:
    good = sdo((">", "2B 1710 00 64000000"), ("<", "60 1710 00 00000000"), start_ms=5)
    assert silent(run(*ordered(good, ALIVE)))
    search = sdo((">", READ), ("<", "80 0010 00 00000206"), start_ms=5)
    assert one(run(*ordered(search, ALIVE)), "sdo.abort").severity == "info"


def test_an_abort_names_the_device_and_exchanged_index_bytes() -> None:
    """ABB CM588: the master reads 001Ah where 1A00h is meant."""
    refused = sdo((">", "40 1A00 01 00000000"), ("<", "80 1A00 01 00000206"), start_ms=5)
    described = BusDescription.loads('[node.5]\nname = "boom sensor"')
    finding = one(run(*ordered(refused, ALIVE), description=described), "sdo.abort")
    assert finding.text.startswith("Node 5 (boom sensor) refused the read of 001Ah:01")
    assert "1A00h" in finding.cause


def test_reads_of_what_a_node_does_not_have_are_one_note() -> None:
    """hilch_ixxat1: 1008h, 1009h and 100Ah of node 9, asked again after its restart."""
    asked = [
        row
        for at, index in enumerate(("0810", "0910", "0A10", "0810"))
        for row in sdo(
            (">", f"40 {index} 00 00000000"),
            ("<", f"80 {index} 00 00000206"),
            start_ms=100 + 1000 * at,
        )
    ]
    finding = one(run(*ordered(asked, ALIVE)), "sdo.abort")
    assert finding.severity == "info"
    assert "refused 4 reads of 3 objects between +0." in finding.text
    assert "1008h:00 manufacturer device name, 1009h:00" in finding.text
    assert "100Ah:00" in finding.text
    assert finding.text.endswith("; object does not exist (06020000h).")


def test_reads_and_writes_of_one_absent_object_are_told_together() -> None:
    """bg_can0: 6042h is written and read by a program that takes the node for a drive."""
    write = sdo((">", "2B 4260 00 F4010000"), ("<", "80 4260 00 00000206"), start_ms=5)
    read = sdo((">", "40 4260 00 00000000"), ("<", "80 4260 00 00000206"), start_ms=500)
    finding = one(run(*ordered(write, read, ALIVE)), "sdo.abort")
    assert finding.severity == "warning"
    assert "refused 1 write and 1 read of 6042h:00" in finding.text
    assert "another device" in finding.cause


def test_a_refused_write_tells_its_value_and_why() -> None:
    refused = sdo((">", "2F 2910 01 05000000"), ("<", "80 2910 01 30000906"), start_ms=5)
    finding = one(run(*ordered(refused, ALIVE)), "sdo.abort")
    assert "refused the write of 5 to 1029h:01" in finding.text
    assert finding.cause == "The device does not allow this value."


def test_an_abort_that_is_cut_short_gives_no_code() -> None:
    refused = sdo((">", "2B 1710 00 FA000000"), ("<", "80 1710 00 02"), start_ms=5)
    result = run(*ordered(refused, ALIVE))
    assert "gives no code" in one(result, "sdo.abort").text
    assert result.analysis.sdo[0].abort_code is None


@pytest.mark.triggers("sdo.no_answer")
def test_requests_that_stay_unanswered() -> None:
    asked = [*sdo((">", READ), start_ms=500), *sdo((">", READ), start_ms=1000)]
    answered = sdo((">", READ), ("<", VALUE), start_ms=700)
    finding = one(run(*ordered(asked, answered, ALIVE)), "sdo.no_answer")
    assert "2 SDO requests" in finding.text
    assert "within 500 ms" in finding.text


@pytest.mark.triggers("sdo.no_answer")
def test_a_node_that_says_it_is_at_work_is_not_starting_any_more() -> None:
    """A LIR may keep silent for 4 s after its boot-up, but then it keeps silent altogether."""
    boot = [frame(100, 0x000, "8205"), frame(1000, 0x705, "00"), frame(1010, 0x000, "0105")]
    asked = sdo((">", READ), start_ms=2000)
    lir = {5: load_device("lir-ma158k")}
    mute = run(*ordered(boot, asked, OTHER), end_ms=4000, devices=lir)
    assert silent(mute)
    beating = run(*ordered(boot, asked, heartbeats(1100, 4000), OTHER), devices=lir)
    assert one(beating, "sdo.no_answer").severity == "warning"


@pytest.mark.near_miss("sdo.no_answer")
@pytest.mark.parametrize("case", ["nobody", "answered", "end", "gap", "off", "boot"])
def test_silence_that_accuses_nobody(case: str) -> None:
    asked = sdo((">", READ), start_ms=500)
    match case:
        case "nobody":
            items = ordered(sdo((">", READ), node=6, start_ms=500), ALIVE)
        case "answered":
            items = ordered(sdo((">", READ), ("<", VALUE), start_ms=500), ALIVE)
        case "end":
            items = ordered(sdo((">", READ), start_ms=3999), ALIVE)
        case "gap":
            early, late = heartbeats(0, 500), heartbeats(2000, 4000)
            gap = Gap(502 * MS, 1999 * MS, "adapter lost")
            assert silent(run(*early, *asked, gap, *late))
            return
        case "off":
            later = [frame(2000, 0x705, "00"), *heartbeats(2100, 4000, state="7F")]
            items = ordered(asked, later, OTHER)
        case _:
            reset = [frame(480, 0x000, "8105"), frame(900, 0x705, "00")]
            beats = [*heartbeats(0, 450), *heartbeats(1000, 4000, state="7F")]
            items = ordered(asked, reset, beats, OTHER)
    assert silent(run(*items))


STOPPED = ordered(
    [frame(400, 0x000, "0205")], heartbeats(0, 400), heartbeats(450, 4000, state="04")
)


@pytest.mark.triggers("sdo.while_stopped")
def test_a_stopped_node_is_mute_by_right() -> None:
    """LA trap 22: SDO time-outs in STOPPED are the client's mistake."""
    asked = every(3, 600, (">", READ), start_ms=1000)
    finding = one(run(*ordered(asked, STOPPED, OTHER)), "sdo.while_stopped")
    assert finding.severity == "info"
    assert "3 SDO requests" in finding.text


@pytest.mark.near_miss("sdo.while_stopped")
def test_a_stopped_node_that_answers_is_told_by_nobody() -> None:
    asked = every(3, 600, (">", READ), ("<", VALUE), start_ms=1000)
    assert silent(run(*ordered(asked, STOPPED, OTHER)))


REFUSED = ((">", "2F 0018 02 FF000000"), ("<", "80 0018 02 30000906"))
PREOP = ordered(heartbeats(0, 8000, state="7F"), heartbeats(0, 8000, node=9))


@pytest.mark.triggers("sdo.configuration_failed")
def test_a_configuration_that_fails_again_and_again() -> None:
    finding = one(run(*ordered(every(4, 2000, *REFUSED), PREOP)), "sdo.configuration_failed")
    assert finding.severity == "error"
    assert "4 times" in finding.text
    assert "1800h:02" in finding.text


@pytest.mark.near_miss("sdo.configuration_failed")
def test_refusals_of_a_node_that_runs_are_plain_aborts() -> None:
    running = ordered(heartbeats(0, 8000), heartbeats(0, 8000, node=9))
    finding = one(run(*ordered(every(4, 2000, *REFUSED), running)), "sdo.abort")
    assert "4 times" in finding.text
    assert one(run(*ordered(every(2, 2000, *REFUSED), PREOP)), "sdo.abort").severity == "warning"


def block_read(crc: int | None = None, sent_again: int = 0) -> list[tuple[str, str]]:
    """A block read of 14 bytes; the client misses the second segment so many times."""
    data = b"ABCDEFGabcdefg"
    check = crc_hqx(data, 0) if crc is None else crc
    first, second = data[:7].hex(), data[7:].hex()
    frames = [
        (">", "A4 0810 00 20 000000"),
        ("<", "C6 0810 00 0E000000"),
        (">", "A3 00000000000000"),
        ("<", "01" + first),
        ("<", "82" + second),
    ]
    if sent_again:
        frames += [(">", "A2 01 20 0000000000"), ("<", "81" + second)]
        frames += [(">", "A2 00 20 0000000000"), ("<", "81" + second)] * (sent_again - 1)
        frames += [(">", "A2 01 20 0000000000")]
    else:
        frames += [(">", "A2 02 20 0000000000")]
    return [
        *frames,
        ("<", f"C1{check & 0xFF:02X}{check >> 8:02X}0000000000"),
        (">", "A1" + "00" * 7),
    ]


@pytest.mark.triggers("sdo.block_crc")
def test_a_block_whose_crc_is_wrong() -> None:
    finding = one(run(*sdo(*block_read(crc=0x1234))), "sdo.block_crc")
    assert "the receiver accepted it" in finding.text
    refused = [*block_read()[:-1], (">", "80 0810 00 04000405")]
    assert one(run(*sdo(*refused)), "sdo.block_crc").evidence == [0, 7]


@pytest.mark.near_miss("sdo.block_crc")
def test_a_block_of_which_a_segment_was_not_recorded() -> None:
    whole = sdo(*block_read())
    assert silent(run(*whole))
    assert silent(run(*whole[:3], *whole[4:]))
    assert silent(run(*whole[:4], *whole[6:]))


@pytest.mark.triggers("sdo.block_repeated")
def test_segments_that_are_sent_again() -> None:
    often = run(*sdo(*block_read(sent_again=3)))
    assert "3 times" in one(often, "sdo.block_repeated").text
    assert often.analysis.sdo[0].value == "ABCDEFGabcdefg"


@pytest.mark.near_miss("sdo.block_repeated")
def test_a_block_of_which_a_segment_is_sent_again_once() -> None:
    assert silent(run(*sdo(*block_read())))
    assert silent(run(*sdo(*block_read(sent_again=1))))


def segmented_read(*toggles: int, announced: int = 21, bytes_sent: int = 21) -> list[Row]:
    exchange = [(">", "40 0920 00 00000000"), ("<", f"41 0920 00 {announced:02X}000000")]
    for number, toggle in enumerate(toggles):
        part = f"{number:02X}" * 7
        last = number == len(toggles) - 1
        unused = len(toggles) * 7 - bytes_sent if last else 0
        exchange.append((">", f"{0x60 | number % 2 << 4:02X}" + "00" * 7))
        exchange.append(("<", f"{toggle << 4 | unused << 1 | last:02X}" + part))
    return sdo(*exchange)


@pytest.mark.triggers("sdo.toggle")
def test_a_toggle_bit_that_stands_still() -> None:
    result = run(*segmented_read(0, 0, 0))
    assert "toggle bit" in one(result, "sdo.toggle").text
    assert result.analysis.sdo[0].data == b"\0" * 7 + b"\1" * 7 + b"\2" * 7
    rows = segmented_read(0, 0, 0)[:6]
    refused = [*rows, frame(6, 0x605, "8009200000000305")]
    assert one(run(*refused), "sdo.toggle").evidence == [0]


@pytest.mark.near_miss("sdo.toggle")
def test_a_toggle_bit_that_alternates_or_of_which_frames_are_missing() -> None:
    rows = segmented_read(0, 1, 0)
    assert silent(run(*rows))
    lost = run(*rows[:2], *rows[4:])
    assert silent(lost)
    assert lost.analysis.sdo[0].value is None


@pytest.mark.triggers("sdo.size_mismatch")
def test_a_transfer_that_brings_less_than_it_announced() -> None:
    finding = one(run(*segmented_read(0, 1, 0, announced=32, bytes_sent=20)), "sdo.size_mismatch")
    assert finding.severity == "info"
    assert "32 bytes and brought 20" in finding.text


@pytest.mark.near_miss("sdo.size_mismatch")
def test_a_transfer_that_brings_what_it_announced_or_is_not_recorded_whole() -> None:
    assert silent(run(*segmented_read(0, 1, 0)))
    rows = segmented_read(0, 1, 0, 1)
    assert silent(run(*rows[:4], *rows[8:]))


BROKEN_OFF = ((">", "40 0810 00 00000000"), ("<", "41 0810 00 15000000"), (">", "60" + "00" * 7))


@pytest.mark.triggers("sdo.interrupted")
def test_transfers_that_a_new_request_breaks_off() -> None:
    finding = one(run(*ordered(every(4, 500, *BROKEN_OFF), ALIVE)), "sdo.interrupted")
    assert "3 SDO transfers" in finding.text


@pytest.mark.near_miss("sdo.interrupted")
def test_transfers_that_resets_and_gaps_break_off() -> None:
    assert silent(run(*ordered(every(3, 500, *BROKEN_OFF), ALIVE)))
    cuts = [Gap(round((30 + 500 * n) * MS), round((40 + 500 * n) * MS), "lost") for n in range(4)]
    pieces = [sdo(*BROKEN_OFF, start_ms=10 + 500 * n) for n in range(4)]
    items: list[Row | Gap] = []
    for piece, cut in zip(pieces, cuts, strict=True):
        items += [*piece, cut]
    result = run(*items, frame(3000, 0x705, "05"))
    assert [row.result for row in result.analysis.sdo] == ["interrupted"] * 4
    assert silent(result)


@pytest.mark.triggers("sdo.late_answer")
def test_answers_after_the_client_s_time_out() -> None:
    """The client waits 500 ms, asks again or gives up, and the node takes 700 ms."""
    asked = [frame(t, 0x605, "4000100000000000") for t in (100, 600)]
    answers = [frame(t, 0x585, "4300100096010100") for t in (800, 1300)]
    result = run(*ordered(asked, answers, ALIVE))
    finding = one(result, "sdo.late_answer")
    assert "700 ms" in finding.text
    assert "500 ms" in finding.text
    assert [row.result for row in result.analysis.sdo] == ["no answer", "ok"]
    given_up = [asked[0], frame(600, 0x605, "8000100000000405"), answers[0]]
    finding = one(run(*ordered(given_up, ALIVE)), "sdo.late_answer")
    assert "it took 700 ms, and the client waits 500 ms" in finding.text


def asked_twice(first_ms: float) -> list[Row]:
    """Two reads that the client gives up after 500 ms, and an answer 700 ms after the second."""
    asked = [frame(t, 0x605, "4000100000000000") for t in (first_ms, 9000)]
    aborted = [frame(t + 500, 0x605, "8000100000000405") for t in (first_ms, 9000)]
    return ordered(asked, aborted, [frame(9700, 0x585, "4300100096010100")])


@pytest.mark.triggers("sdo.late_answer")
@pytest.mark.parametrize(("first_ms", "told"), [(2000, "700 ms"), (8000, "1.7 s")])
def test_an_answer_is_not_that_to_a_request_of_long_ago(first_ms: float, told: str) -> None:
    """Unless the client repeats it at its time-out: then a busy node answers the first."""
    alive = ordered(heartbeats(0, 10_000), heartbeats(0, 10_000, node=9))
    late = [f for f in run(*ordered(asked_twice(first_ms), alive)).findings() if "late" in f.id]
    assert [f"it took {told}, and the client waits 500 ms" in f.text for f in late] == [True]


@pytest.mark.near_miss("sdo.late_answer")
def test_two_clients_that_read_the_same_object() -> None:
    asked = [frame(t, 0x605, "4000100000000000") for t in (100, 101)]
    answers = [frame(t, 0x585, "4300100096010100") for t in (102, 103)]
    result = run(*ordered(asked, answers, ALIVE))
    assert silent(result)
    assert [row.answer_us for row in result.analysis.sdo] == [2000.0, 2000.0]


@pytest.mark.near_miss("sdo.late_answer")
def test_a_clock_that_steps_between_two_clients_requests_lets_nobody_wait() -> None:
    asked = [frame(t, 0x605, "4000100000000000") for t in (100, 2001)]
    answers = [frame(t, 0x585, "4300100096010100") for t in (2002, 2003)]
    result = run(*ordered(asked, answers, [frame(0, 0x705, "05"), frame(2010, 0x705, "05")]))
    assert not silent(result)
    step = BusSilenceRow("can0", 100 * MS, 2001 * MS, [1, 2])
    result.analysis.bus_silences.append(step)
    assert silent(result)


@pytest.mark.triggers("sdo.doubled_answer")
def test_one_request_and_two_answers() -> None:
    twice = ((">", READ), ("<", VALUE), ("<", "43 0010 00 9A010200"))
    finding = one(run(*ordered(every(2, 500, *twice), ALIVE)), "sdo.doubled_answer")
    assert finding.severity == "error"
    assert "2 SDO requests got two answers, 2 of them with something else" in finding.text
    alike = ((">", READ), ("<", VALUE), (">", "60"), ("<", VALUE))
    finding = one(run(*ordered(every(3, 500, *alike), ALIVE)), "sdo.doubled_answer")
    assert finding.severity == "warning"


@pytest.mark.near_miss("sdo.doubled_answer")
def test_a_frame_that_can_repeats_and_a_log_with_every_frame_twice() -> None:
    once = ((">", READ), ("<", VALUE))
    rows = every(5, 500, *once)
    repeated = [frame(row[0] / MS + 0.2, 0x585, "4300100096010100") for row in rows[1::2]]
    assert silent(run(*ordered(rows, repeated, ALIVE)))
    doubled = [(row[0] + 50_000, *row[1:]) for row in rows]
    assert silent(run(*ordered(rows, doubled, ALIVE)))


@pytest.mark.near_miss("sdo.doubled_answer")
def test_two_requests_with_two_equal_answers_are_a_chance() -> None:
    alike = ((">", READ), ("<", VALUE), (">", "60"), ("<", VALUE))
    assert "sdo.doubled_answer" not in run(*ordered(every(2, 500, *alike), ALIVE)).ids()


@pytest.mark.triggers("sdo.wrong_answer")
def test_answers_of_another_object() -> None:
    wrong = ((">", READ), ("<", "4F 0110 00 00000000"), ("<", VALUE))
    finding = one(run(*ordered(every(3, 500, *wrong), ALIVE)), "sdo.wrong_answer")
    assert "1001h:00 instead of 1000h:00" in finding.text


@pytest.mark.near_miss("sdo.wrong_answer")
def test_requests_of_two_clients_that_overlap() -> None:
    overlap = (
        (">", READ),
        (">", "40 0110 00 00000000"),
        ("<", VALUE),
        ("<", "4F 0110 00 00000000"),
    )
    result = run(*ordered(every(5, 500, *overlap), ALIVE))
    assert silent(result)
    assert {row.result for row in result.analysis.sdo} == {"ok"}
    assert len(result.analysis.sdo) == 10


SAVE = ((">", "23 1010 01 73617665"), ("<", "60 1010 01 00000000"))


@pytest.mark.triggers("sdo.save_storm")
def test_a_master_that_saves_without_end() -> None:
    minutes = every(12, 60_000, *SAVE)
    beats = heartbeats(0, 12 * 60_000, node=9, every_ms=1000)
    finding = one(run(*ordered(minutes, beats)), "sdo.save_storm")
    assert "12 times" in finding.text
    assert "69 days" in finding.text
    assert "100,000" in finding.assumed[0]


@pytest.mark.near_miss("sdo.save_storm")
def test_saves_while_a_machine_is_set_up() -> None:
    beats = heartbeats(0, 9 * 60_000, node=9, every_ms=1000)
    assert silent(run(*ordered(every(9, 60_000, *SAVE), beats)))
    slow = heartbeats(0, 20 * 600_000, node=9, every_ms=10_000)
    assert silent(run(*ordered(every(20, 600_000, *SAVE), slow)))


WRITE = ((">", "2B 1710 00 64000000"), ("<", "60 1710 00 00000000"))
READ_BACK = ((">", "40 1710 00 00000000"), ("<", "4B 1710 00 FA000000"))


@pytest.mark.triggers("sdo.write_not_kept")
def test_a_value_that_reads_back_as_another_one() -> None:
    rows = [*sdo(*WRITE, start_ms=10), *sdo(*READ_BACK, start_ms=50)]
    finding = one(run(*ordered(rows, OTHER)), "sdo.write_not_kept")
    assert "confirmed 100 for 1017h:00" in finding.text
    assert "reads back 250" in finding.text


@pytest.mark.near_miss("sdo.write_not_kept")
def test_a_value_that_a_reset_takes_back_or_that_changes_by_itself() -> None:
    reset = [frame(20, 0x000, "8105"), frame(40, 0x705, "00")]
    taken_back = [*sdo(*WRITE, start_ms=10), *reset, *sdo(*READ_BACK, start_ms=50)]
    assert silent(run(*ordered(taken_back, OTHER)))
    moving = [
        *sdo((">", "23 0360 00 00000000"), ("<", "60 0360 00 00000000"), start_ms=10),
        *sdo((">", "40 0360 00 00000000"), ("<", "43 0360 00 05000000"), start_ms=50),
    ]
    assert silent(run(*ordered(moving, OTHER)))
    same = [*sdo(*WRITE), *sdo(READ_BACK[0], ("<", "4B 1710 00 64000000"), start_ms=50)]
    assert silent(run(*ordered(same, OTHER)))


def test_refusals_that_the_maker_describes_are_notes() -> None:
    """Haomiao: 6502h and others may abort although the profile has them."""
    refused = sdo((">", "40 0260 00 00000000"), ("<", "80 0260 00 00000206"), start_ms=5)
    result = run(*ordered(refused, ALIVE), devices={5: load_device("haomiao-38")})
    assert one(result, "sdo.abort").severity == "info"
