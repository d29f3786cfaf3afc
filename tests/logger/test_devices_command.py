"""`syncline devices`: lists, one device, and the check of a file with its exit codes."""

import json
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
    assert "x.eds:1: error: [2000]: DataType is missing" in out
    assert "    instead: write the DataType, like 0x0007 for UNSIGNED32" in out
    assert "can be used: x, 1 objects; " in err


def test_a_check_of_several_files_as_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = tmp_path / "x.eds", tmp_path / "y.eds"
    first.write_bytes(BROKEN)
    second.write_bytes(BROKEN.replace(b"[2000]", b"[2001]") * 9)
    code, out, err = run(capsys, "--check", str(first), str(second), "--format", "json")
    assert (code, err) == (0, "")
    found = json.loads(out)
    assert found["schema"] == "syncline.device-check/1"
    assert [Path(each["path"]).name for each in found["files"]] == ["x.eds", "y.eds"]
    one = found["files"][0]
    assert (one["usable"], one["problem"], one["objects"]) == (True, None, 1)
    assert sum(one["counts"].values()) == len(one["faults"])
    fault = next(each for each in one["faults"] if each["kind"] == "data_type")
    assert fault.keys() == {"kind", "severity", "where", "line", "text", "write", "reading"}
    assert (fault["severity"], fault["line"], fault["where"]) == ("error", 1, "[2000]")


def test_many_faults_of_one_kind_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.eds"
    path.write_bytes(b"".join(BROKEN.replace(b"2000", b"20%02d" % n) for n in range(20)))
    _, out, _ = run(capsys, "--check", str(path))
    assert out.count("DataType is missing") == 5
    assert "15 more of kind data_type (--all shows them)" in out
    _, out, _ = run(capsys, "--check", str(path), "--all")
    assert out.count("DataType is missing") == 20


@pytest.mark.parametrize(
    ("threshold", "code"), [("error", 1), ("warning", 1), ("note", 1), ("never", 0)]
)
def test_a_script_can_ask_for_an_exit_code(
    threshold: str, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.eds"
    path.write_bytes(BROKEN)
    assert run(capsys, "--check", str(path), "--fail-on", threshold)[0] == code


def test_one_file_of_which_nothing_can_be_used_among_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, bad = tmp_path / "x.eds", tmp_path / "y.xdd"
    good.write_bytes(BROKEN)
    bad.write_bytes(b"<a><b></a>")
    code, out, err = run(capsys, "--check", str(good), str(bad))
    assert code == 2
    assert "DataType is missing" in out
    assert "no well-formed XML: mismatched tag: line 1" in err


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
        (["jn2100", "lir-918"], "one NAME at a time"),
        (["jn2100", "--format", "json"], "go with --check"),
    ],
)
def test_wrong_use(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, *words)
    assert (code, out) == (2, "")
    assert said in err
