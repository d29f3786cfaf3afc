"""A description file as the checks see it, and the faults they find."""

from functools import cached_property
from typing import TYPE_CHECKING

from syncline_schemas.devices.check.kinds import KINDS, Severity
from syncline_schemas.eds import EdsWarning, LoadedEds, assumed_value, variables
from syncline_schemas.eds_repair import Entry, number
from syncline_schemas.eds_text import Section
from syncline_schemas.records import dataclass

if TYPE_CHECKING:
    from canopen.objectdictionary import ODVariable

Key = tuple[int, int | None]
"""Index and subindex; None for the section of an object that has subindexes."""


@dataclass(frozen=True, slots=True)
class Fault:
    """Something wrong in a description file.

    Attributes:
        kind: name in `KINDS`.
        where: "[1A00sub1]", "line 12" or "file". line: None where it is not known.
        text: what is wrong. write: what to write instead.
        reading: what our reader made of it; "" where it takes what stands there.
    """

    kind: str
    severity: Severity
    where: str
    line: int | None
    text: str
    write: str
    reading: str

    def __str__(self) -> str:
        return f"{self.where}: {self.text}"


def fault(kind: str, where: str, line: int | None, text: str, write: str = "") -> Fault:
    """A fault of a known kind; `write` where more can be said than the kind says."""
    known = KINDS[kind]
    return Fault(kind, known.severity, where, line, text, write or known.write, known.reading)


def of_warning(warning: EdsWarning) -> Fault:
    """What the reader repaired, as a fault."""
    return fault(warning.kind, warning.where, warning.line, warning.text)


class Sheet:
    """A loaded file with what checks ask of it.

    Attributes:
        suffix: of the file's name, like ".dcf". is_xml: an XDD or XDC.
    """

    def __init__(self, loaded: LoadedEds, suffix: str, *, is_xml: bool) -> None:
        self.loaded = loaded
        self.suffix = suffix.lower()
        self.is_xml = is_xml

    def fault(self, kind: str, key: Key, text: str, write: str = "", at: str = "") -> Fault:
        """A fault of an object, in the line of a key of its section."""
        section = self.loaded.objects.written.get(key)
        index, sub = key
        name = f"[{index:04X}]" if sub is None else f"[{index:04X}sub{sub:X}]"
        line = section.lines.get(at, section.line) if section else 0
        return fault(kind, name, line or None, text, write)

    def general(self, kind: str, name: str, text: str, write: str = "", at: str = "") -> Fault:
        """A fault of a section that is no object."""
        section = self.section(name)
        line = section.lines.get(at, section.line) if section else 0
        return fault(kind, f"[{name}]", line or None, text, write)

    def section(self, name: str) -> Section | None:
        """A section by its name."""
        return self.loaded.text.sections.get(name.lower())

    def info(self, key: str) -> int | None:
        """Number of a key of [DeviceInfo]."""
        stated = self.loaded.info.get(f"deviceinfo.{key}")
        return number(stated) if stated else None

    @property
    def indexes(self) -> list[int]:
        """All objects in order, data types and dummies left out."""
        return [index for index in self.loaded.objects.heads if index >= 0x1000]

    def has(self, index: int) -> bool:
        """Whether an object is described."""
        return index in self.loaded.objects.heads

    def subs(self, index: int) -> list[int]:
        """Subindexes of an array or record; none of a variable."""
        return sorted(self.loaded.objects.entries.get(index, {}))

    def key(self, index: int, sub: int) -> Key:
        """Where an object's keys stand: a variable has no section for subindex 0."""
        return (index, sub) if self.subs(index) else (index, None)

    def entry(self, index: int, sub: int) -> Entry:
        """Repaired keys and values of a variable; empty where it is not described."""
        objects = self.loaded.objects
        if self.subs(index):
            return objects.entries[index].get(sub, {})
        return objects.heads.get(index, {}) if sub == 0 else {}

    def written(self, index: int, sub: int, key: str) -> str:
        """A value as it stands in the file, "" where it is missing."""
        section = self.loaded.objects.written.get(self.key(index, sub))
        return section.get(key) if section else ""

    def value(self, index: int, sub: int, node: int = 1) -> int | None:
        """The number that the file gives an object, for a node."""
        found = assumed_value(self.loaded.od, index, sub, node)
        return found if isinstance(found, int) else None

    @cached_property
    def variables(self) -> dict[tuple[int, int], "ODVariable"]:
        """Every variable by index and subindex, dummies left out."""
        found = {(each.index, each.subindex): each for each in variables(self.loaded.od)}
        return {key: each for key, each in found.items() if key[0] >= 0x1000}

    def type_unknown(self, index: int, sub: int) -> bool:
        """Whether the reader had to make bytes of an object whose data type it does not know."""
        section = self.loaded.objects.written.get(self.key(index, sub))
        return section is not None and f"[{section.name}]" in self._of_unknown_type

    @cached_property
    def _of_unknown_type(self) -> set[str]:
        unknown = ("data_type", "data_type_unknown")
        return {each.where for each in self.loaded.warnings if each.kind in unknown}
