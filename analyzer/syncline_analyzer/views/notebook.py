"""Sessions, analyses and findings as notebooks show them."""

from collections.abc import Iterable
from html import escape
from itertools import groupby
from pathlib import Path

from syncline_analyzer.results import Analysis, Finding
from syncline_analyzer.views.lanes import cells, lanes_of
from syncline_analyzer.views.markdown import extent, verdict, where
from syncline_analyzer.views.palette import SEVERITY_COLOURS, STATE_COLOURS, STATE_LETTERS, css
from syncline_analyzer.views.words import Clock, names_of, node_label, printable, undrawn

MAX_FINDINGS, MAX_LANES = 20, 40
_CELLS = 200


def session_html(paths: Iterable[Path], analysis: Analysis | None) -> str:
    """A session: its files, and what is known of them by now."""
    if analysis is not None:
        return analysis_html(analysis)
    files = ", ".join(path.name for path in paths)
    return f"<p><b>{_text(files)}</b>: not analyzed yet; ask for <code>.findings()</code></p>"


def analysis_html(analysis: Analysis) -> str:
    """What was found, and the NMT states of the nodes."""
    clock = Clock.of(analysis.capture)
    parts = [f"<p><b>{_text(verdict(analysis))}</b><br>{_text(extent(analysis))}</p>"]
    if analysis.findings:
        labels = names_of(analysis.nodes)
        shown = analysis.findings[:MAX_FINDINGS]
        rows = "".join(
            _finding_row(place, each, clock, labels) for place, each in enumerate(shown, 1)
        )
        left = len(analysis.findings) - len(shown)
        more = f"<p>and {left} more in <code>findings</code></p>" if left else ""
        parts.append(f"<table><tbody>{rows}</tbody></table>{more}")
    if clock.timed and analysis.nmt_states:
        parts.append(_lanes(analysis))
    return "".join(parts)


def finding_html(finding: Finding) -> str:
    """One finding with its cause and what to check next."""
    rows = [
        ("likely cause", finding.cause),
        ("check next", finding.check_next),
        ("assumed", "; ".join(finding.assumed)),
        ("evidence", f"frames {', '.join(map(str, finding.evidence[:10]))}"),
    ]
    told = "".join(
        f'<tr><th style="text-align:left">{name}</th><td style="text-align:left">{_text(text)}</td></tr>'
        for name, text in rows
        if text
    )
    head = f"{_severity(finding)} {_text(finding.text)} <code>{_text(finding.id)}</code>"
    return f"<div>{head}<table><tbody>{told}</tbody></table></div>"


def _finding_row(
    place: int, finding: Finding, clock: Clock, labels: dict[tuple[str, int], str]
) -> str:
    cells_ = [
        str(place),
        _severity(finding),
        _text(clock.short(finding.start_ns)),
        _text(where(finding, labels)),
        _text(finding.text),
    ]
    return "<tr>" + "".join(f'<td style="text-align:left">{cell}</td>' for cell in cells_) + "</tr>"


def _severity(finding: Finding) -> str:
    colour = css(SEVERITY_COLOURS[finding.severity])
    return f'<b style="color:{colour}">{finding.severity.upper()}</b>'


def _lanes(analysis: Analysis) -> str:
    """A bar of each node; what a state is stands in its tooltip and letter."""
    capture, labels = analysis.capture, names_of(analysis.nodes)
    several = len(capture.buses) > 1
    rows = []
    lanes = lanes_of(analysis)
    for key in list(lanes)[:MAX_LANES]:
        label = labels.get(key, node_label(key[1]))
        label = f"{key[0]} {label}" if several else label
        bar = _bar(cells(lanes[key], capture.begin_ns, capture.end_ns, _CELLS))
        rows.append(
            f'<tr><td style="text-align:left">{_text(label)}</td>'
            f'<td style="width:100%;padding:0"><div style="display:flex">{bar}</div></td></tr>'
        )
    left = len(lanes) - len(rows)
    more = f"<p>and {left} more nodes</p>" if left > 0 else ""
    more += f"<p>{_text(told)}</p>" if (told := undrawn(capture)) else ""
    return f'<table style="width:100%"><tbody>{"".join(rows)}</tbody></table>{more}'


def _bar(states: list[str]) -> str:
    runs = [(state, len(list(run))) for state, run in groupby(states)]
    return "".join(
        f'<span title="{_text(state)}" style="flex:{count};overflow:hidden;'
        f'background:{css(STATE_COLOURS[state]) if state else "none"};color:black">'
        f"{STATE_LETTERS.get(state, '&nbsp;')}</span>"
        for state, count in runs
    )


def _text(text: str) -> str:
    return escape(printable(text))
