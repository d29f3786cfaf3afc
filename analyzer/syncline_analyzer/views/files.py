"""What `--out` writes: report, Rerun recording, tables and findings of one analysis."""

from pathlib import Path
from typing import TYPE_CHECKING

from syncline_analyzer.results import Analysis
from syncline_analyzer.views.frame_rows import ReadFrames
from syncline_analyzer.views.json_view import findings_json

if TYPE_CHECKING:
    from syncline_analyzer.views.rerun_logs import Decode


def write_all(
    analysis: Analysis,
    folder: Path,
    read_frames: ReadFrames | None = None,
    decode: "Decode | None" = None,
) -> list[Path]:
    """Write `report.html`, `session.rrd`, `findings.json` and `tables/*.parquet`; return the files.

    With `read_frames` (`Session.frames`) the recording lists frames, with `decode` (`Session.decoding`)
    and the values that they carry.
    """
    from syncline_analyzer.views.report_html import write_report
    from syncline_analyzer.views.rerun_view import write_rrd
    from syncline_analyzer.views.tables import write_tables

    folder.mkdir(parents=True, exist_ok=True)
    findings = folder / "findings.json"
    findings.write_text(findings_json(analysis), encoding="utf-8")
    return [
        write_report(analysis, folder / "report.html"),
        write_rrd(analysis, folder / "session.rrd", read_frames, decode=decode),
        findings,
        *write_tables(analysis, folder / "tables"),
    ]
