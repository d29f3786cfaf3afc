"""The text of an EDS or DCF file as sections and keys, whatever is wrong with it (CiA 306 4)."""

import re
from dataclasses import field

from syncline_schemas.records import dataclass

_HEADER = re.compile(r"\[([^\]]*)\]?\s*(.*)")
_COMMENT = re.compile(r"(?<=\s);")
_CONTROL = re.compile(r"[\x00-\x1f\x7f\x85\u2028\u2029]+")


@dataclass(frozen=True, slots=True)
class EdsWarning:
    """Something in the file that is wrong and was repaired, or that could not be used.

    `where` is "line 12", "[1A00sub1]" or "file". `kind` names what `devices.check.kinds` explains;
    `line` is None where no line can be named.
    """

    where: str
    text: str
    kind: str = field(default="", compare=False)
    line: int | None = field(default=None, compare=False)

    def __str__(self) -> str:
        return f"{self.where}: {self.text}"


@dataclass(slots=True)
class Section:
    """A section: its name as written, its line number, and its values by key in lower case.

    `lines` holds the line of each key, as far as it is another than the section's.
    """

    name: str
    line: int
    values: dict[str, str] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)

    def get(self, key: str) -> str:
        """Value of a key, "" where it is missing or empty."""
        return self.values.get(key, "")


MAX_WARNINGS = 10_000


@dataclass(slots=True)
class EdsText:
    """Sections in file order by name in lower case, and what was wrong with the text.

    The first ten thousand warnings are kept; `untold` counts the others.
    """

    sections: dict[str, Section] = field(default_factory=dict)
    warnings: list[EdsWarning] = field(default_factory=list)
    untold: int = 0

    def warn(self, where: str | Section | int, text: str, kind: str, key: str = "") -> None:
        """Add a warning about a line, a section or one of its keys, or the file as a whole."""
        if len(self.warnings) >= MAX_WARNINGS:
            self.untold += 1
            return
        line = None
        if isinstance(where, Section):
            line = where.lines.get(key, where.line) or None
            where = f"[{where.name}]"
        elif isinstance(where, int):
            line, where = where, f"line {where}"
        self.warnings.append(EdsWarning(where, text, kind, line))


def decoded(data: bytes) -> tuple[str, list[EdsWarning]]:
    """Text of a file: UTF-8, UTF-16 by its mark or its zeros, else Windows-1252."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", errors="replace"), [_encoding("encoding: UTF-16")]
    if data.startswith(b"\xef\xbb\xbf"):
        text = data[3:].decode("utf-8", errors="replace")
        return text, [_encoding("starts with a UTF-8 byte order mark", "byte_order_mark")]
    if len(data) > 8 and data[1::2].count(0) > len(data) // 4:
        return data.decode("utf-16-le", errors="replace"), [
            _encoding("encoding: UTF-16 without a mark")
        ]
    try:
        return data.decode("utf-8"), []
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
        return text, [_encoding("encoding: neither ASCII nor UTF-8, read as Windows-1252")]


def _encoding(text: str, kind: str = "encoding") -> EdsWarning:
    return EdsWarning("file", text, kind)


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
        found.warn(number, f"section [{name} has no closing bracket", "bracket")
    elif match[2] and match[2][0] not in ";#":
        found.warn(
            number, f"text after section [{name}] ignored: {match[2][:40]!r}", "section_tail"
        )
    known = found.sections.get(name.lower())
    if known is not None:
        found.warn(
            number,
            f"section [{name}] again (first in line {known.line}): only new keys are taken",
            "duplicate_section",
        )
        return known
    return found.sections.setdefault(name.lower(), Section(name, number))


def _add_key(found: EdsText, section: Section | None, line: str, number: int) -> None:
    key, separator, value = line.partition("=" if "=" in line else ":")
    if not separator or not key.strip():
        found.warn(number, f"neither section nor key, ignored: {line[:60]!r}", "stray_line")
        return
    if section is None:
        found.warn(number, f"key before the first section, ignored: {line[:60]!r}", "stray_line")
        return
    if separator == ":":
        found.warn(number, f"{key.strip()} is separated by a colon instead of '='", "colon")
    key, value = key.strip(), _bare(found, value.strip(), number)
    if key.lower() not in section.values:
        section.values[key.lower()] = value
        section.lines[key.lower()] = number
    elif section.values[key.lower()] != value:
        _keep_first(found, section, key, value, number)


def _bare(found: EdsText, value: str, number: int) -> str:
    """The value without an inline comment and without quotes round it."""
    bare = "" if value.startswith(";") else _COMMENT.split(value, maxsplit=1)[0].rstrip()
    if bare != value:
        said = f"inline comment ignored: {value[len(bare) :].strip()[:60]!r}"
        found.warn(number, said, "inline_comment")
    if len(bare) >= 2 and bare[0] == bare[-1] == '"':
        return bare[1:-1].strip()
    return bare


def _keep_first(found: EdsText, section: Section, key: str, value: str, number: int) -> None:
    first = section.values[key.lower()]
    if not first:
        section.values[key.lower()] = value
        section.lines[key.lower()] = number
        return
    found.warn(
        number,
        f"{key} in [{section.name}] again: {first[:30]!r}, the first one, is kept, not {value[:30]!r}",
        "duplicate_key",
    )
