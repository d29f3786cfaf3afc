"""Histograms in a Rerun recording: SYNC periods and PDO responses as bar charts."""

import numpy as np
import rerun as rr

from syncline_analyzer.results import Analysis
from syncline_analyzer.views.histogram import Bars, histograms, period_bars
from syncline_analyzer.views.palette import line_colour
from syncline_analyzer.views.rerun_layout import PlotContent
from syncline_analyzer.views.rerun_names import part
from syncline_analyzer.views.rerun_sink import Sink


def histogram_plots(analysis: Analysis) -> list[PlotContent]:
    """The bar charts of an analysis."""
    return [PlotContent(f"{bars.label} [count per us]", at) for at, bars in _charts(analysis)]


def write_histograms(sink: Sink, analysis: Analysis) -> None:
    """Write them."""
    for entity, bars in _charts(analysis):
        chart = rr.BarChart(
            bars.per_us,
            abscissa=bars.middle_us,
            widths=bars.width_us.astype(np.float32),
            color=line_colour(2),
        )
        sink.static(entity, chart)


def _charts(analysis: Analysis) -> list[tuple[str, Bars]]:
    """Bars by entity."""
    charts = [
        (f"/histogram/{part(bus)}/{part(bars.title)}", bars) for bus, bars in period_bars(analysis)
    ]
    return [
        *charts,
        *(
            (f"/histogram/{part(responses.bus)}/{responses.cob_id:03X}h", bars)
            for responses, bars in histograms(analysis)
        ),
    ]
