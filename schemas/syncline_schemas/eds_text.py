"""The text of an EDS or DCF file as sections and keys, whatever is wrong with it (CiA 306 4)."""

import re
from dataclasses import dataclass, field

_HEADER = re.compile(r"\[([^\]]*)\]?\s*(.*)")
_COMMENT = re.compile(r"\s+;.*$")
_CONTROL = re.compile(r"[\x00-\x1f\x7f\x85\u2028\u2029]+")


@dataclass(frozen=True, slots=True)
class EdsWarning:
    """Something in the file that is wrong and was repaired, or that could not be used.

    `where` is "line 12", "[1A00sub1]" or "file".
    """

    where: str
    text: str

    def __str__(self) -> str:
        return f"{self.where}: {self.text}"


@dataclass(slots=True)
class Section:
    """A section: its name as written, its line number, and its values by key in lower case."""

    name: str
    line: int
    values: dict[str, str] = field(default_factory=dict)

    def get(self, key: str) -> str:
        """Value of a key, "" where it is missing or empty."""
        return self.values.get(key, "")


@dataclass(slots=True)
class EdsText:
    """Sections in file order by name in lower case, and what was wrong with the text."""

    sections: dict[str, Section] = field(default_factory=dict)
    warnings: list[EdsWarning] = field(default_factory=list)

    def warn(self, where: str, text: str) -> None:
        """Add a warning."""
        self.warnings.append(EdsWarning(where, text))


def decoded(data: bytes) -> tuple[str, list[EdsWarning]]:
    """Text of a file: UTF-8, UTF-16 by its mark or its zeros, else Windows-1252."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", errors="replace"), [_encoding("UTF-16")]
    if data.startswith(b"\xef\xbb\xbf"):
        text = data[3:].decode("utf-8", errors="replace")
        return text, [EdsWarning("file", "starts with a UTF-8 byte order mark")]
    if len(data) > 8 and data[1::2].count(0) > len(data) // 4:
        return data.decode("utf-16-le", errors="replace"), [_encoding("UTF-16 without a mark")]
    try:
        return data.decode("utf-8"), []
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
        return text, [_encoding("neither ASCII nor UTF-8, read as Windows-1252")]


def _encoding(text: str) -> EdsWarning:
    return EdsWarning("file", f"encoding: {text}")


def parse(data: bytes) -> EdsText:
    """Sections of a file; lines that are neither section, key nor comment become warnings."""
    text, warnings = decoded(data)
    found = EdsText(warnings=warnings)
    section: Section | None = None
    for number, raw in enumerate(re.split(r"\r\n|\r|\n", text), 1):
        line = _CONTROL.sub(" ", raw).strip()
        if not line or line[0] in ";#":
            continue
        if line[0] == "[":
            section = _opened(found, line, number)
        else:
            _add_key(found, section, line, number)
    return found


def _opened(found: EdsText, line: str, number: int) -> Section:
    match = _HEADER.match(line)
    assert match is not None
    name = match[1].strip()
    if "]" not in line:
        found.warn(f"line {number}", f"section [{name} has no closing bracket")
    elif match[2] and match[2][0] not in ";#":
        found.warn(f"line {number}", f"text after section [{name}] ignored: {match[2][:40]!r}")
    known = found.sections.get(name.lower())
    if known is not None:
        found.warn(
            f"line {number}",
            f"section [{name}] again (first in line {known.line}): only new keys are taken",
        )
        return known
    return found.sections.setdefault(name.lower(), Section(name, number))


def _add_key(found: EdsText, section: Section | None, line: str, number: int) -> None:
    key, separator, value = line.partition("=" if "=" in line else ":")
    if not separator or not key.strip():
        found.warn(f"line {number}", f"neither section nor key, ignored: {line[:60]!r}")
        return
    if section is None:
        found.warn(f"line {number}", f"key before the first section, ignored: {line[:60]!r}")
        return
    if separator == ":":
        found.warn(f"line {number}", f"{key.strip()} is separated by a colon instead of '='")
    key, value = key.strip(), _bare(found, value.strip(), number)
    if key.lower() not in section.values:
        section.values[key.lower()] = value
    elif section.values[key.lower()] != value:
        _keep_first(found, section, key, value, number)


def _bare(found: EdsText, value: str, number: int) -> str:
    """The value without an inline comment and without quotes round it."""
    bare = "" if value.startswith(";") else _COMMENT.sub("", value)
    if bare != value:
        found.warn(f"line {number}", f"inline comment ignored: {value[len(bare) :].strip()[:60]!r}")
    if len(bare) >= 2 and bare[0] == bare[-1] == '"':
        return bare[1:-1].strip()
    return bare


def _keep_first(found: EdsText, section: Section, key: str, value: str, number: int) -> None:
    first = section.values[key.lower()]
    if not first:
        section.values[key.lower()] = value
        return
    found.warn(
        f"line {number}",
        f"{key} in [{section.name}] again: {first[:30]!r}, the first one, is kept, not {value[:30]!r}",
    )
