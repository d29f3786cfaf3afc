"""What devices told of their own state: wear, hours, temperature, stored errors."""

import re

from syncline_analyzer.results import DeviceHealthRow
from syncline_analyzer.views.tables import table
from tests.analyzer.traps.script import Script, Told


def health(told: Told, what: str) -> DeviceHealthRow:
    (row,) = [row for row in told.analysis.device_health if row.what == what]
    return row


def test_the_wear_counter_of_the_eeprom_with_the_saves_between() -> None:
    """Sheet skbis-lir-da158: 1011h:4 counts write attempts."""
    script = Script("lir-da158", 5).heartbeat(0, 3000).read(100, 0x1011, 4, 1200)
    script.save(200).save(300, 2).read(1000, 0x1011, 4, 1204)
    row = health(script.told(), "EEPROM writes")
    assert (row.index, row.sub, row.unit, row.reads) == (0x1011, 4, "writes", 2)
    assert (row.first_value, row.last_value) == (1200.0, 1204.0)
    assert "+4 between the first and the last read, 2 saves seen" in row.note


def test_operating_hours_of_a_lir_begin_anew_with_each_restart() -> None:
    script = Script("lir-da158", 5).heartbeat(0, 3000)
    script.read(100, 0x6508, 0, 123).read(200, 0x6508, 0, 124).read(300, 0x6508, 0, 1)
    row = health(script.told(), "operating time")
    assert (row.first_value, row.last_value, row.max, row.unit) == (12.3, 0.1, 12.4, "h")
    assert "time since the last restart" in row.note
    assert "began anew 1 time" in row.note


def test_the_temperature_of_a_jn2100_with_its_sign_and_the_user_s_scale() -> None:
    """Vectors JN22 and JN23: 250 is 25.0 degC, -55 is -5.5 degC."""
    script = Script("jn2100", 10).heartbeat(0, 3000)
    script.read(100, 0x4080, 0, 250).read(200, 0x4080, 0, -55).read(300, 0x4004, 2, 5, size=1)
    told = script.told()
    row = health(told, "temperature")
    assert (row.last_value, row.min, row.max, row.unit) == (-5.5, -5.5, 25.0, "degC")
    assert health(told, "self-test of the axes").text == "x ok, y failed, z ok"
    script.overrides = "temp_scale = 1"
    assert health(script.told(), "temperature").max == 250.0


def test_an_encoder_of_which_only_1000h_is_known_has_the_profile_s_hours() -> None:
    script = Script(None, 8).heartbeat(0, 3000).read(50, 0x1000, 0, 0x00020196)
    row = health(script.read(100, 0x6508, 0, 123456).told(), "operating time")
    assert (row.device, row.last_value, row.unit) == (None, 12345.6, "h")
    unused = health(script.read(200, 0x6508, 0, 0xFFFFFFFF).told(), "operating time")
    assert (unused.text, unused.last_value, unused.reads) == ("not used", 12345.6, 2)


def test_the_error_list_as_it_was_read_last() -> None:
    script = Script("lir-da158a", 5).heartbeat(0, 3000).emcy(50, 0x7320, 0x01, "0100000000")
    script.read(100, 0x1003, 0, 2, size=1).read(110, 0x1003, 1, 0x7320)
    script.read(120, 0x1003, 2, 0x8130)
    row = health(script.told(), "error list")
    assert (row.last_value, row.unit) == (2.0, "entries")
    assert row.text.startswith("7320h position error (EMCY, frame ")
    assert "8130h node guarding error (from before the capture)" in row.text
    script.write(200, 0x1003, 0, 0, size=1).read(300, 0x1003, 0, 0, size=1)
    cleared = health(script.told(), "error list")
    assert (cleared.first_value, cleared.last_value, cleared.text) == (2.0, 0.0, "no entry")


def test_what_was_not_read_has_no_row_and_the_table_has_its_columns() -> None:
    told = Script("jn2100", 10).heartbeat(0, 3000).read(100, 0x4080, abort=0x08000000).told()
    assert told.analysis.device_health == []
    assert {"what", "last_value", "note", "last_ns"} <= set(table(told.analysis, "device_health"))


def test_the_summary_names_it_among_what_is_known() -> None:
    script = Script("jn2100", 10).heartbeat(0, 3000).read(100, 0x4080, 0, 250)
    assert re.search(r"temperature +25 degC", script.told().summary)
