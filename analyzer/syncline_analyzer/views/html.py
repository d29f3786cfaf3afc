"""Elements of HTML in which no text from a bus or file can become markup."""

import json
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from syncline_analyzer.views.words import printable


class Html(str):
    """Text that is HTML already; every other string is escaped when it becomes a child."""

    __slots__ = ()


_VOID = frozenset({"meta", "rect", "path", "br", "input"})


def element(name: str, /, *children: object, **attributes: object) -> Html:
    """An element; an attribute that is None or False is left out, `class_` and `data_x` are spelt so.

    >>> element("p", "a < b", class_="x", data_from=1)
    '<p class="x" data-from="1">a &lt; b</p>'
    """
    told = "".join(
        f" {key.rstrip('_').replace('_', '-')}"
        + ("" if value is True else f'="{escape(printable(str(value)))}"')
        for key, value in attributes.items()
        if value is not None and value is not False
    )
    if name in _VOID:
        return Html(f"<{name}{told}/>")
    return Html(f"<{name}{told}>{joined(children)}</{name}>")


def joined(children: Iterable[object]) -> Html:
    """Children one after the other; None is nothing."""
    return Html("".join(_child(child) for child in children if child is not None))


def _child(child: object) -> str:
    return child if isinstance(child, Html) else escape(printable(str(child)))


def data_script(identity: str, value: Any) -> Html:
    r"""JSON inside the page, written so that nothing in it can end the script.

    >>> data_script("x", "</script>")
    '<script type="application/json" id="x">"\\u003c/script>"</script>'
    """
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    safe = text.replace("<", "\\u003c")
    return Html(f'<script type="application/json" id="{escape(identity)}">{safe}</script>')


def table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[object]]) -> Html:
    """A table that scrolls sideways on its own; a head that starts with ">" is of figures.

    The first column that is not of a bus names its rows.
    """
    figures = [head.startswith(">") for head in heads]
    named = next((i for i, head in enumerate(heads) if head.removeprefix(">") != "Bus"), 0)
    top = (
        element("th", head.removeprefix(">"), scope="col", class_="n" if n else None)
        for head, n in zip(heads, figures, strict=True)
    )
    body = (
        element("tr", *(
            element("th" if i == named else "td", cell, class_="n" if figures[i] else None,
                    scope="row" if i == named else None)
            for i, cell in enumerate(row)
        ))
        for row in rows
    )  # fmt: skip
    whole = element(
        "table",
        element("caption", caption),
        element("thead", element("tr", *top)),
        element("tbody", *body),
    )
    return element("div", whole, class_="scroll", tabindex=0, role="region", aria_label=caption)
