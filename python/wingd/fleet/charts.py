"""Figures as SVG: points with bars, and lines."""

from __future__ import annotations

import html
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass
class Series:
    """Named points: x, y, and half the bar length or None."""

    name: str
    points: Sequence[tuple[float, float, float | None]]
    line: bool = False


def chart(series: Iterable[Series], x: str, y: str, label: str, times: bool = False) -> str:
    """Return a figure as SVG; `label` describes it for screen readers, `times`: x are days since 1970."""
    series = [one for one in series if one.points]
    if not series:
        return '<p class="soft">No data to plot.</p>'
    from ..plot import axes

    with axes(figsize=(6.4, 3.4)) as ax:
        for one in series:
            at, of, bars = zip(*one.points, strict=True)
            if one.line:
                ax.plot(at, of, label=one.name)
            else:
                # As an image: paths of thousands of points are megabytes.
                ax.errorbar(
                    at,
                    of,
                    [bar or 0 for bar in bars],
                    fmt="o",
                    ms=3,
                    lw=0,
                    elinewidth=0.8,
                    label=one.name,
                    rasterized=True,
                )
        if times:
            ax.xaxis_date()
            # For a single day the margin would be years.
            days = [point[0] for one in series for point in one.points]
            ax.set_xlim(min(days) - 1, max(days) + 1)
        ax.set_xlabel(x)
        ax.set_ylabel(y)
        if len(series) > 1:
            ax.legend(fontsize="small")
        return f'<figure role="img" aria-label="{html.escape(label)}">{_svg(ax.figure, label)}</figure>'


def _svg(figure, name: str) -> str:
    """Return the figure as an element of a page, equal for equal figures."""
    import matplotlib
    from matplotlib import pyplot

    output = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        figure.savefig(output, format="svg", dpi=150, metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    pyplot.close(figure)
    text = output.getvalue()
    # A page needs no names of vocabularies.
    return re.sub(r' xmlns(:\w+)?="[^"]*"', "", text[text.index("<svg") :])
