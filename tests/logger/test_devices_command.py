"""`syncline devices`: lists, one device, and the check of a file with its exit codes."""

from pathlib import Path

import pytest

from syncline_logger.cli import main

BROKEN = b"[2000]\nParameterName=T\nObjectType=7\nDefaultValue=x\n"


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as caught:
        main(["devices", *words])
    out, err = capsys.readouterr()
    assert isinstance(caught.value.code, int)
    return caught.value.code, out, err


def test_the_list_names_all_devices(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys)
    assert (code, err) == (0, "")
    for name in ("lir-da158", "lir-da158a", "lir-ma158k", "lir-918", "jn2100", "haomiao-38"):
        assert f" {name} " in out


def test_a_broken_file_of_ones_own_is_told_beside_the_list(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.eds").write_bytes(b"nothing")
    monkeypatch.setenv("SYNCLINE_DEVICES", str(tmp_path))
    code, out, err = run(capsys)
    assert code == 0
    assert "jn2100" in out
    assert "mine: " in err


def test_one_device_with_objects_scales_and_quirks(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "lir-da158a")
    assert code == 0
    for part in ("6004h", "Position value", "counts", "7320h", "position error", "bootup bytes",
                 "00h, 7Fh", "node-guard", "bytes 3..4", "max_rpm"):  # fmt: skip
        assert part in out


def test_a_file_is_a_device_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.eds"
    path.write_bytes(BROKEN)
    code, out, _ = run(capsys, str(path))
    assert code == 0
    assert "2000h" in out
    assert "Repaired in the EDS" in out


def test_a_check_lists_the_faults_of_a_file_that_can_be_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.eds"
    path.write_bytes(BROKEN)
    code, out, err = run(capsys, "--check", str(path))
    assert code == 0
    assert "x.eds: [2000]: DataType is missing" in out
    assert "can be used" in err


@pytest.mark.parametrize("content", [b"", b"nothing useful\n", b"\x00\x01\x02" * 100])
def test_a_check_of_a_file_in_which_nothing_can_be_used(
    content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.eds"
    path.write_bytes(content)
    code, out, err = run(capsys, "--check", str(path))
    assert (code, out) == (2, "")
    assert "holds no object" in err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["lir-da159"], "did you mean lir-da158"),
        (["--check", "no.eds"], "no.eds cannot be read"),
        (["jn2100", "--check", "no.eds"], "not both"),
    ],
)
def test_wrong_use(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, *words)
    assert (code, out) == (2, "")
    assert said in err
