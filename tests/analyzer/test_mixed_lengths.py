"""TPDOs whose frames have several lengths, of devices whose mapping can be changed."""

from collections.abc import Callable

import pytest

from tests.analyzer.traps.script import Script

LONG, SHORT = "183#01020304", "183#0102"


def haomiao(stretch: str = SHORT, base: str = LONG) -> Script:
    """An encoder of writable mapping, never read; for 20 s its frames are others."""
    script = Script("haomiao-38", 3).heartbeat(0, 60_000).every(0, 20_000, 20, base)
    return script.every(20_000, 40_000, 20, stretch).every(40_000, 60_000, 20, base)


@pytest.mark.triggers("config.pdo_mixed_lengths")
@pytest.mark.parametrize("batch", [1 << 20, 333])
def test_a_length_that_goes_there_and_back_is_told(batch: int) -> None:
    finding = haomiao().told(batch).finding("config.pdo_mixed_lengths")
    assert (finding.severity, finding.node) == ("warning", 3)
    assert "2 bytes (1000 frames) and 4 bytes (2000 frames)" in finding.text
    assert "changed 2 times, first at +20.000 s" in finding.text
    assert "for a while" in finding.cause
    assert finding.assumed == ["1800h:1 = 183h (eds-default)"]


@pytest.mark.triggers("config.pdo_mixed_lengths")
@pytest.mark.parametrize("period", [20, 500])
def test_two_lengths_that_take_turns_are_those_of_two_senders(period: int) -> None:
    """However seldom the second one sends: its frames stand one by one between the others."""
    script = Script("haomiao-38", 3).heartbeat(0, 20_000).every(0, 20_000, 20, LONG)
    finding = script.every(7, 20_000, period, SHORT).told().finding("config.pdo_mixed_lengths")
    assert finding.cause.startswith("Another device sends on this identifier")
    assert "side by side" in finding.cause
    assert len(finding.evidence) == 20


def _restarted(script: Script) -> Script:
    return script.boot(30_000)


def _remapped(script: Script) -> Script:
    return script.write(39_500, 0x1A00, 0, 1, size=1)


def _tried(script: Script) -> Script:
    return script.write(19_500, 0x1A00, 1, 0x60040010, size=4, answered=False)


def _its_own_setting(script: Script) -> Script:
    return script.write(19_500, 0x2100, 0, 1, size=1)


def _blind(script: Script) -> Script:
    script.rows = [row for row in script.rows if not 30_000 <= row[0] < 31_000]
    script.gaps.append((30_000, 31_000))
    return script


@pytest.mark.near_miss("config.pdo_mixed_lengths")
@pytest.mark.parametrize("change", [_restarted, _remapped, _tried, _its_own_setting, _blind])
def test_what_may_have_changed_the_mapping_explains_the_length(
    change: Callable[[Script], Script],
) -> None:
    assert "config.pdo_mixed_lengths" not in change(haomiao()).told().ids


@pytest.mark.near_miss("config.pdo_mixed_lengths")
def test_other_lengths_that_are_no_fault() -> None:
    once = Script("haomiao-38", 3).heartbeat(0, 40_000).every(0, 20_000, 20, LONG)
    assert "config.pdo_mixed_lengths" not in once.every(20_000, 40_000, 20, SHORT).told().ids
    empty = haomiao(stretch="183#")
    assert "config.pdo_mixed_lengths" not in empty.told().ids
    remote = haomiao(stretch=LONG).every(10_010, 50_000, 100, "183#R")
    assert "config.pdo_mixed_lengths" not in remote.told().ids
    received = haomiao(stretch="203#0102", base="203#01020304").every(0, 60_000, 20, LONG)
    assert "config.pdo_mixed_lengths" not in received.told().ids
    guess = haomiao()
    guess.device = None
    assert "config.pdo_mixed_lengths" not in guess.told().ids
    known = haomiao().read(-500, 0x1A00, 0, 1, size=1).read(-400, 0x1A00, 1, 0x60040020)
    assert "config.pdo_mixed_lengths" not in known.told().ids
    assert "config.pdo_length" in known.told().ids


@pytest.mark.near_miss("config.pdo_mixed_lengths")
@pytest.mark.parametrize("batch", [1 << 20, 9])
def test_a_pdo_of_empty_frames_alone_has_no_length(batch: int) -> None:
    """As logs write remote frames that do not mark them."""
    empty = Script("haomiao-38", 3).heartbeat(0, 20_000).every(0, 20_000, 20, "183#")
    assert "config.pdo_mixed_lengths" not in empty.told(batch).ids
    later = empty.every(20_000, 40_000, 20, LONG).told(batch)
    assert "config.pdo_mixed_lengths" not in later.ids
