"""The vocabulary of CiA 301 against the tables of the canopen library."""

import pytest
from canopen.emcy import EmcyError
from canopen.objectdictionary import datatypes
from canopen.sdo.exceptions import SdoAbortedError

from syncline_schemas.canopen import emcy, lss, sdo
from syncline_schemas.canopen.datatypes import DATA_TYPES


def test_every_abort_code_that_the_library_knows_has_words() -> None:
    assert SdoAbortedError.CODES.keys() <= sdo.ABORT_CODES.keys()
    extra = sdo.ABORT_CODES.keys() - SdoAbortedError.CODES.keys()
    assert {code >> 16 for code in extra} == {0x0601}


@pytest.mark.parametrize("high", range(0x100))
def test_every_code_group_that_the_library_knows_has_words(high: int) -> None:
    known = EmcyError(high << 8, 0, b"", 0.0).get_desc()
    words = emcy.code_meaning(high << 8)
    assert words.startswith("unknown") == (known == "" and not 0x50 <= high < 0x80), words
    first = known.lower().replace("/", " ").split()
    group = emcy.GROUPS.get(high, "")
    assert not known or not group or first[0] in group or high in _FINER, (known, group)


_FINER = {0x31, 0x33, 0x63, 0x81, 0x82, 0x61, 0x62}
"""Groups for which the library has only the name of their family."""


def test_data_types_have_the_library_s_numbers() -> None:
    for known in DATA_TYPES.values():
        assert getattr(datatypes, known.name) == known.code
    assert {known.code for known in DATA_TYPES.values() if known.kind == "signed"} == set(
        datatypes.SIGNED_TYPES
    )


def test_error_register_bits_have_names_in_order() -> None:
    assert emcy.register_bits(0xFF) == list(emcy.REGISTER_BITS.values())
    assert emcy.register_bits(0) == []
    assert emcy.register_bits(0x80, {0: "general"}) == ["bit 7"]


def test_unknown_codes_are_shown_as_numbers() -> None:
    assert sdo.abort_meaning(1) == "unknown code"
    assert lss.command_name(0x5E) == "inquire node-ID"
