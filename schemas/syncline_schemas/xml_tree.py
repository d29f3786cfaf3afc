"""XML that somebody sent, as a small tree with line numbers: no entities, no DTD, bounded."""

from collections.abc import Iterator
from dataclasses import field
from xml.parsers import expat

from syncline_schemas.records import dataclass

MAX_DEPTH = 100
MAX_ELEMENTS = 500_000
MAX_TEXT = 1 << 16
"""Characters of an element's text that are kept."""


class XmlFault(ValueError):
    """The text is no XML that can be read; the message says where and why."""


@dataclass(slots=True)
class Element:
    """An element; names are without their namespace."""

    tag: str
    line: int
    attributes: dict[str, str]
    children: list["Element"] = field(default_factory=list)
    text: str = ""

    def get(self, name: str) -> str:
        """Value of an attribute with single spaces, "" where there is none."""
        return " ".join(self.attributes.get(name, "").split())

    def all(self, tag: str) -> Iterator["Element"]:
        """Every element of this name below this one, in document order."""
        waiting = list(reversed(self.children))
        while waiting:
            element = waiting.pop()
            if element.tag == tag:
                yield element
            waiting.extend(reversed(element.children))

    def first(self, tag: str) -> "Element | None":
        """The first element of this name below this one."""
        return next(self.all(tag), None)


def parse_xml(data: bytes, encoding: str | None = None) -> Element:
    """Root element of a document; `encoding` overrides what it declares.

    Raises:
        XmlFault: it is not well-formed, has a DTD (where entities are declared, the way to bombs and
            to other files), is nested deeper than 100 or has more than 500,000 elements.
    """
    tree = _Tree(encoding)
    try:
        tree.parser.Parse(data, True)
    except expat.ExpatError as error:
        raise XmlFault(f"is no well-formed XML: {error}") from error
    except (ValueError, LookupError) as error:
        if isinstance(error, XmlFault):
            raise
        raise XmlFault(f"is no XML that can be read: {error}") from error
    if tree.root is None:
        raise XmlFault("is no well-formed XML: there is no element")
    return tree.root


class _Tree:
    def __init__(self, encoding: str | None) -> None:
        self.root: Element | None = None
        self._open: list[Element] = []
        self._count = 0
        self.parser = expat.ParserCreate(encoding)
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._text
        self.parser.StartDoctypeDeclHandler = self._doctype

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if len(self._open) >= MAX_DEPTH or self._count > MAX_ELEMENTS:
            raise XmlFault(
                f"has too many or too deeply nested elements (line {self.parser.CurrentLineNumber})"
            )
        bare = {key.rpartition(":")[2]: value for key, value in attributes.items()}
        element = Element(name.rpartition(":")[2], self.parser.CurrentLineNumber, bare)
        if self._open:
            self._open[-1].children.append(element)
        else:
            self.root = element
        self._open.append(element)

    def _end(self, name: str) -> None:
        element = self._open.pop()
        element.text = " ".join(element.text.split())

    def _text(self, text: str) -> None:
        if self._open and len(self._open[-1].text) < MAX_TEXT:
            self._open[-1].text += text

    def _doctype(self, *parts: object) -> None:
        raise XmlFault(
            f"has a document type declaration in line {self.parser.CurrentLineNumber}, which an XDD "
            "does not need: not read"
        )
