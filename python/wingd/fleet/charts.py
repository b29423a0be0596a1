"""Figures as SVG: points with bars, lines, axes with round steps."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

# Colours distinguishable by colour-blind readers (Okabe and Ito), dark enough on white.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#a0522d", "#cc79a7", "#56718a", "#b8860b", "#444444")
WIDTH, HEIGHT, LEFT, BOTTOM, TOP, RIGHT = 640, 340, 62, 46, 14, 12
STEPS = 5


@dataclass
class Series:
    """Named points: x, y, and half the bar length or None."""

    name: str
    points: Sequence[tuple[float, float, float | None]]
    line: bool = False


def ticks(low: float, high: float, least: float = 0.0, count: int = STEPS) -> list[float]:
    """Return round values between `low` and `high`, at least `least` apart."""
    span = (high - low) or abs(high) or 1.0
    raw = span / count
    base = 10 ** math.floor(math.log10(raw))
    step = next(base * f for f in (1, 2, 5, 10) if base * f >= raw)
    step = max(step, least)
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


def plain(value: float) -> str:
    """Return a number with at most six digits."""
    return f"{value:.6g}"


def chart(series: Iterable[Series], x: str, y: str, label: str, times: bool = False) -> str:
    """Return a figure as SVG; `label` describes it for screen readers."""
    series = [one for one in series if one.points]
    if not series:
        return '<p class="soft">No data to plot.</p>'
    xs = [p[0] for one in series for p in one.points]
    ys = [p[1] + s * (p[2] or 0) for one in series for p in one.points for s in (-1, 1)]
    # For a single day the relative margin would be years.
    (x0, x1), (y0, y1) = _bounds(xs, 1.0 if times else 0.0), _bounds(ys)

    def at(px: float, py: float) -> tuple[float, float]:
        return (
            LEFT + (px - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT),
            HEIGHT - BOTTOM - (py - y0) / (y1 - y0) * (HEIGHT - BOTTOM - TOP),
        )

    parts = [f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{html.escape(label)}">']
    parts += _axes((x0, x1), (y0, y1), at, x, y, times)
    for index, one in enumerate(series):
        parts += _points(one, COLOURS[index % len(COLOURS)], at)
    parts.append("</svg>")
    return f"<figure>{''.join(parts)}{_legend(series)}</figure>"


def _bounds(values: list[float], least: float = 0.0) -> tuple[float, float]:
    low, high = min(values), max(values)
    margin = max(0.05 * (high - low), least) or 0.05 * abs(high) or 1.0
    return low - margin, high + margin


def _axes(xb, yb, at, x, y, times) -> list[str]:
    parts = []
    for value in ticks(*yb):
        px, py = at(xb[0], value)
        parts.append(f'<path class="grid" d="M{px:.1f} {py:.1f}H{WIDTH - RIGHT}"/>')
        parts.append(f'<text x="{px - 6:.1f}" y="{py + 4:.1f}" text-anchor="end">{plain(value)}</text>')
    for value in ticks(*xb, 1.0 if times else 0.0):
        px, py = at(value, yb[0])
        text = _day(value) if times else plain(value)
        parts.append(f'<path class="grid" d="M{px:.1f} {py:.1f}V{TOP}"/>')
        parts.append(f'<text x="{px:.1f}" y="{py + 17:.1f}" text-anchor="middle">{text}</text>')
    middle = (HEIGHT - BOTTOM + TOP) / 2
    parts.append(f'<text x="{(WIDTH + LEFT) / 2:.0f}" y="{HEIGHT - 6}" text-anchor="middle">{html.escape(x)}</text>')
    parts.append(
        f'<text transform="translate(14 {middle:.0f}) rotate(-90)" text-anchor="middle">{html.escape(y)}</text>'
    )
    return parts


def _day(days: float) -> str:
    from datetime import date, timedelta

    return (date(1970, 1, 1) + timedelta(days=math.floor(days))).isoformat()[5:]


def _points(one: Series, colour: str, at) -> list[str]:
    placed = [(at(px, py), at(px, py - bar)[1] - at(px, py + bar)[1] if bar else 0.0) for px, py, bar in one.points]
    parts = []
    if one.line:
        path = "L".join(f"{px:.1f} {py:.1f}" for (px, py), _ in placed)
        parts.append(f'<path d="M{path}" fill="none" stroke="{colour}" stroke-width="1.6"/>')
        return parts
    bars = "".join(f"M{px:.1f} {py - h / 2:.1f}v{h:.1f}" for (px, py), h in placed if h > 0.5)
    dots = "".join(f"M{px:.1f} {py:.1f}h0" for (px, py), _ in placed)
    size = 5 if len(placed) <= 60 else 3
    parts.append(f'<path d="{bars}" stroke="{colour}" stroke-width="1" fill="none"/>')
    parts.append(f'<path d="{dots}" stroke="{colour}" stroke-width="{size}" stroke-linecap="round"/>')
    return parts


def _legend(series: list[Series]) -> str:
    if len(series) < 2:
        return ""
    items = "".join(
        f'<li><i style="background:{COLOURS[k % len(COLOURS)]}"></i>{html.escape(one.name)}</li>'
        for k, one in enumerate(series)
    )
    return f'<ul class="legend">{items}</ul>'
