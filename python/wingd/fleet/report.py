"""`wingd-fleet report`: one HTML file that opens offline."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from pathlib import Path

from .. import __version__
from .charts import Series, chart
from .desk import Desk
from .lake import FleetError

# Rows shown of a long table; further rows are counted and available by `wingd-fleet query`.
ROWS = 25
# Maximum number of wings in a figure, so that it stays readable: those with the largest differences.
DRAWN = 8
# Number of load classes per aircraft in a figure.
BINS = 10


def write(desk: Desk, output: Path, solve: str | None = None, against: str | None = None, made: bool = False) -> None:
    """Write the report of one solve (default: the last by name), compared with another."""
    solve = solve or desk.solves[-1]
    if solve not in desk.solves or (against and against not in desk.solves):
        raise FleetError(f"solve {solve} or {against} is not among: {', '.join(desk.solves)}")
    against = against or next((one for one in desk.solves if one != solve), None)
    parts = [_head(desk, solve, made), _deflection(desk, solve), _mount(desk, solve), _detection(desk, solve)]
    parts += [_live(desk, solve), _failing(desk, solve), _compared(desk, against, solve)]
    style = Path(__file__).with_name("report.css").read_text()
    title = f"Wings of a fleet: {solve}"
    output.write_text(
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{html.escape(title)}</title><style>{style}</style></head><body><main>{''.join(parts)}"
        f"<footer>Written by wingd-fleet {__version__}. Lengths in metres or millimetres, angles in milliradians, image "
        f"coordinates in pixels; sigma is one standard deviation. Each table is a view: wingd-fleet query --lake LAKE "
        f"&quot;FROM deflection_by_aircraft&quot;.</footer></main></body></html>\n"
    )


def _number(value, digits: int) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    return f"{value:.{digits}f}"


#: Columns of the views: heading, digits (None: text), factor.
_COLUMNS: dict[str, tuple[str, int | None, float]] = {
    "aircraft": ("aircraft", None, 1),
    "wing": ("wing", None, 1),
    "aircraft_type": ("type", None, 1),
    "flights": ("flights", 0, 1),
    "frames": ("frames", 0, 1),
    "tip_marker": ("tip marker", None, 1),
    "deflection_m": ("mean deflection, m", 3, 1),
    "scatter_of_mean_m": ("scatter of flights over root n, mm", 1, 1000),
    "least_m": ("minimum, m", 3, 1),
    "most_m": ("maximum, m", 3, 1),
    "sigma_frame_m": ("sigma of a frame, mm", 1, 1000),
    "side": ("side", None, 1),
    "eta": ("eta", 2, 1),
    "arc_length_m": ("arc length from the root, m", 3, 1),
    "load_t": ("mean load, t", 1, 1),
    "sigma_m": ("sigma of the mean, mm", 1, 1000),
    "offset_m": ("offset from the line of its type and side, mm", 1, 1000),
    "over_sigma": ("offset over sigma", 1, 1),
    "recorder_id": ("recorder", None, 1),
    "within_mrad": ("within a flight, mrad", 3, 1),
    "between_mrad": ("from flight to flight, mrad", 3, 1),
    "sigma_mrad": ("sigma of a frame, mrad", 3, 1),
    "used_share": ("markers used, %", 1, 100),
    "sigma_px": ("median sigma, px", 3, 1),
    "residual_px": ("residuals, px", 3, 1),
    "beyond_share": ("beyond 3.29 sigma, %", 2, 100),
    "reason": ("reason", None, 1),
    "markers": ("markers", 0, 1),
    "flight": ("flight", None, 1),
    "shots": ("shots", 0, 1),
    "ok": ("solved", 0, 1),
    "results": ("results", 0, 1),
    "rate_hz": ("results per second", 2, 1),
    "solved_share": ("solved, %", 1, 100),
    "scatter_m": ("its scatter, mm", 1, 1000),
    "mean_m": ("mean difference, mm", 2, 1000),
    "rms_m": ("rms, mm", 2, 1000),
    "won": ("newly solved", 0, 1),
    "lost": ("no longer solved", 0, 1),
    "why": ("reason", None, 1),
}


def _columns(keys: str, **others: tuple[str, int | None, float]) -> list[tuple[str, str, int | None, float]]:
    """Return columns in order, with other headings where a view means something else by a name."""
    return [(key, *(_COLUMNS | others)[key]) for key in keys.split()]


def table(rows: list[dict], columns: Sequence[tuple[str, str, int | None, float]], limit: int = ROWS) -> str:
    """Render rows as a table. A column: key, heading, digits (None: text), factor."""
    if not rows:
        return '<p class="soft">None.</p>'
    head = "".join(
        f"<th{'' if digits is None else ' class=n'}>{html.escape(name)}</th>" for _, name, digits, _ in columns
    )
    lines = []
    for row in rows[:limit]:
        cells = []
        for key, name, digits, factor in columns:
            value = row[key]
            if digits is None:
                text = html.escape("–" if value is None else str(value))
                kind = "" if " " in text else " class=w"
            else:
                text, kind = _number(None if value is None else float(value) * factor, digits), " class=n"
            cells.append(f'<td{kind} data-name="{html.escape(name)}">{text}</td>')
        lines.append(f"<tr>{''.join(cells)}</tr>")
    more = f'<p class="soft">{len(rows) - limit} further rows are not shown.</p>' if len(rows) > limit else ""
    return f'<div class="scroll" tabindex="0"><table class="stack"><thead><tr>{head}</tr></thead><tbody>{"".join(lines)}</tbody></table></div>{more}'


def _head(desk: Desk, solve: str, made: bool) -> str:
    facts = desk.rows(
        "SELECT count(DISTINCT (recorder_id, flight)) AS flights, count(DISTINCT aircraft) AS aircraft, "
        "count(DISTINCT recorder_id) AS recorders, count(image) AS frames, count(*) FILTER (status = 'ok') AS solved, "
        "min(utc)::DATE AS first, max(utc)::DATE AS last, string_agg(DISTINCT program, ', ') AS program "
        "FROM frames WHERE solve = ?",
        [solve],
    )[0]
    share = 100 * facts["solved"] / facts["frames"] if facts["frames"] else 0
    tiles = [
        (facts["flights"], "flights"),
        (facts["aircraft"], "aircraft"),
        (facts["recorders"], "recorders"),
        (facts["frames"], "frames"),
        (f"{share:.1f} %", "of frames solved"),
    ]
    shown = "".join(f"<li><b>{value}</b>{name}</li>" for value, name in tiles)
    warning = (
        '<p class="warning">These flights are synthetic: derived from a few real ones, to test how query time '
        "grows with the number of flights. Nothing in them was measured.</p>"
        if made
        else ""
    )
    return (
        f"<header><h1>Wings of a fleet</h1><p class=soft>Solve <b>{html.escape(solve)}</b> by "
        f"{html.escape(str(facts['program']))}, flights of {facts['first']} to {facts['last']} UTC</p></header>"
        f"{warning}<ul class=tiles>{shown}</ul>"
    )


def _deflection(desk: Desk, solve: str) -> str:
    rows = desk.rows("FROM deflection_by_aircraft WHERE solve = ? ORDER BY aircraft_type, aircraft, wing", [solve])
    columns = _columns(
        "aircraft wing aircraft_type flights frames tip_marker deflection_m scatter_of_mean_m least_m most_m sigma_frame_m",
        deflection_m=("mean deflection of the tip marker, m", 3, 1),
    )
    text = _load(desk, solve) if desk.has_load else _without_load(desk, solve)
    shapes = desk.rows(
        "FROM shape_by_wing WHERE solve = ? ORDER BY aircraft_type, side, eta, arc_length_m, aircraft, wing", [solve]
    )
    along = _columns("aircraft_type side eta arc_length_m aircraft flights load_t deflection_m sigma_m")
    apart = "".join(f'<p class="warning">{html.escape(sentence)}.</p>' for sentence in desk.shapes_apart(solve))
    return (
        f"<h2>Deflection</h2>{apart}{text}<h3>Along the span</h3>{table(shapes, along, 4 * ROWS)}"
        f"<h3>Tip markers by aircraft</h3>{table(rows, columns)}"
    )


def _worst(desk: Desk, sql: str, parameters: list) -> list[tuple[str, str]]:
    """Return aircraft and wing of the wings in a figure: the first rows of `sql`, sorted by name."""
    rows = desk.rows(f"SELECT aircraft, wing FROM ({sql}) LIMIT {DRAWN}", parameters)
    return sorted((row["aircraft"], row["wing"]) for row in rows)


def _name(row) -> str:
    aircraft, wing = row if isinstance(row, tuple) else (row["aircraft"], row["wing"])
    return f"{aircraft} {wing}"


_OF_LEVEL = (
    "SELECT aircraft, wing FROM (SELECT *, abs(deflection_m - median(deflection_m) OVER (PARTITION BY tip_marker)) AS off FROM deflection_by_aircraft WHERE solve = ?) "
    "ORDER BY off DESC, aircraft, wing"
)
_OF_TYPE = (
    "SELECT aircraft, wing FROM aircraft_against_type WHERE solve = ? GROUP BY ALL "
    "ORDER BY max(abs(over_sigma)) DESC NULLS LAST, aircraft, wing"
)
_OF_MOUNT = (
    "SELECT aircraft, wing FROM mount_by_aircraft WHERE solve = ? GROUP BY ALL "
    "ORDER BY max(greatest(within_mrad, coalesce(between_mrad, 0))) DESC NULLS LAST, aircraft, wing"
)


def _without_load(desk: Desk, solve: str) -> str:
    series = []
    for aircraft, wing in _worst(desk, _OF_LEVEL, [solve]):
        rows = desk.rows(
            "SELECT epoch(utc - min(utc) OVER (PARTITION BY recorder_id, flight)) / 3600 AS x, tip_deflection_m AS y, "
            "tip_sigma_deflection_m AS s FROM frames WHERE solve = ? AND aircraft = ? AND wing = ? AND status = 'ok' "
            "AND tip_deflection_m IS NOT NULL ORDER BY hash(recorder_id, flight, series, shot) LIMIT 400",
            [solve, aircraft, wing],
        )
        series.append(Series(_name((aircraft, wing)), [(r["x"], r["y"], r["s"]) for r in rows]))
    return (
        '<p class="warning">The results have no weight and load factor (weight_kg and load_factor): deflections cannot be compared '
        "with the load, nor aircraft with each other. Below, deflection over the hours of each flight. Record aircraft data "
        "and solve the flights again.</p>"
        + chart(
            series,
            "hours since the flight's first frame",
            "deflection of the tip, m",
            "Deflection over the hours of a flight, by wing",
        )
        + _caption(
            "Bars: one standard deviation of a frame.", series, "whose mean deflection is farthest from the median"
        )
    )


def _caption(text: str, series: list[Series], which: str) -> str:
    more = f" Drawn are the {DRAWN} wings {which}." if len(series) == DRAWN else ""
    return f'<p class="caption">{text}{more}</p>'


def _load(desk: Desk, solve: str) -> str:
    parts = []
    # The outermost place of each type and side; the table below has all places.
    outermost = (
        "FROM line_of_type WHERE solve = ? QUALIFY eta = max(eta) OVER (PARTITION BY aircraft_type, side) "
        "ORDER BY aircraft_type, side, arc_length_m"
    )
    for line in desk.rows(outermost, [solve]):
        kind = f"{line['aircraft_type']}, {line['side']}"
        place = f"deflection {line['arc_length_m']:.3f} m from the root"
        series = _of_load(desk, solve, line)
        if line["slope_m_per_t"] is not None:
            ends = [
                (t, line["intercept_m"] + line["slope_m_per_t"] * t, None) for t in (line["least_t"], line["most_t"])
            ]
            series.append(Series(f"all {kind}", ends, line=True))
        slope = _number(line["slope_m_per_t"] and 1000 * line["slope_m_per_t"], 2)
        parts.append(
            f"<h3>{html.escape(kind)}: deflection against weight times load factor</h3>"
            + chart(
                series,
                "weight times load factor, t",
                f"{place}, m",
                f"Deflection against load, {kind}, by wing",
            )
            + _caption(
                f"Means of {BINS} classes of load; bars: standard deviation of the class's frames about the line's slope. Line of all frames of "
                f"the type and side: {slope} mm per tonne, scatter {_number(line['scatter_m'] and 1000 * line['scatter_m'], 1)} mm.",
                series[:DRAWN],
                "farthest from their type's line, relative to sigma",
            )
            + _off_line(line, series)
        )
    rows = desk.rows(
        "FROM aircraft_against_type WHERE solve = ? "
        "ORDER BY max(abs(over_sigma)) OVER (PARTITION BY aircraft, wing) DESC NULLS LAST, aircraft, wing, arc_length_m",
        [solve],
    )
    columns = _columns(
        "aircraft wing aircraft_type side eta arc_length_m flights offset_m scatter_of_mean_m sigma_m over_sigma",
        sigma_m=("sigma of its mean shape, mm", 1, 1000),
    )
    caption = (
        "Places are compared at equal arc lengths, not at tip markers. Errors of survey, camera and mounting stay in the mean of "
        "an aircraft's flights as far as these share them; of frames that were adjusted singly, all errors count as common."
    )
    return (
        "".join(parts)
        + f'<h3>Aircraft compared with their type</h3>{table(rows, columns, 4 * ROWS)}<p class="caption">{caption}</p>'
    )


def _off_line(line: dict, series: list[Series]) -> str:
    """Plot the same points relative to the type's line, which shows the differences."""
    if line["slope_m_per_t"] is None:
        return ""
    off = [
        Series(
            one.name,
            [
                (x, 1000 * (y - line["intercept_m"] - line["slope_m_per_t"] * x), 1000 * (bar or 0))
                for x, y, bar in one.points
            ],
        )
        for one in series
        if not one.line
    ]
    what = f"Deflection relative to the line of {line['aircraft_type']}, by wing"
    return chart(off, "weight times load factor, t", "deflection relative to the line, mm", what)


def _of_load(desk: Desk, solve: str, line: dict) -> list[Series]:
    kind, side = line["aircraft_type"], line["side"]
    rows = desk.rows(
        "WITH f AS (SELECT aircraft, wing, load_t, deflection_m, sigma_own_m FROM shapes WHERE solve = ? AND aircraft_type = ? "
        "AND side IS NOT DISTINCT FROM ? AND eta = ? AND arc_length_m = ? AND load_t IS NOT NULL), "
        "edges AS (SELECT min(load_t) AS low, (max(load_t) - min(load_t)) / ? AS step FROM f) "
        "SELECT aircraft, wing, avg(load_t) AS x, avg(deflection_m) AS y, "
        "coalesce(stddev_samp(deflection_m - ? * load_t), avg(sigma_own_m)) AS s FROM f, edges "
        "GROUP BY aircraft, wing, least(floor((load_t - low) / nullif(step, 0)), ? - 1) ORDER BY aircraft, wing, x",
        [solve, kind, side, line["eta"], line["arc_length_m"], BINS, line["slope_m_per_t"] or 0.0, BINS],
    )
    names = {_name(row) for row in rows}
    of_line = _OF_TYPE.replace(
        "WHERE solve = ?", "WHERE solve = ? AND aircraft_type = ? AND side IS NOT DISTINCT FROM ?"
    )
    drawn = [name for name in map(_name, _worst(desk, of_line, [solve, kind, side])) if name in names]
    drawn = drawn or sorted(names)[:DRAWN]
    return [Series(name, [(r["x"], r["y"], r["s"]) for r in rows if _name(r) == name]) for name in drawn]


def _mount(desk: Desk, solve: str) -> str:
    rows = desk.rows(
        "FROM mount_by_aircraft WHERE solve = ? ORDER BY within_mrad DESC NULLS LAST, aircraft, wing", [solve]
    )
    columns = _columns("aircraft wing recorder_id flights within_mrad between_mrad sigma_mrad")
    flights = desk.rows(
        "SELECT aircraft, wing, epoch(began) / 86400 AS day, sqrt(x_mrad ** 2 + y_mrad ** 2 + z_mrad ** 2) AS turn, within_mrad "
        "FROM mount_by_flight WHERE solve = ? AND began IS NOT NULL ORDER BY began",
        [solve],
    )
    series = [
        Series(
            _name(one), [(r["day"], r["turn"], r["within_mrad"]) for r in flights if (r["aircraft"], r["wing"]) == one]
        )
        for one in _worst(desk, _OF_MOUNT, [solve])
    ]
    figure = chart(
        series,
        "day of the flight (month-day, UTC)",
        "rotation from the ground frame, mrad",
        "Rotation of the camera against its ground frame, flight by flight",
        times=True,
    )
    if not any(one.points for one in series):
        figure = '<p class="soft">These results have no rotation of the mount (method profile).</p>'
    caption = "A flight's mean rotation of the camera against the ground frame; bars: motion within the flight (rms)."
    return (
        f"<h2>Camera mounting</h2>{figure}{_caption(caption, series, 'whose camera moved most')}{table(rows, columns)}"
    )


def _detection(desk: Desk, solve: str) -> str:
    rows = desk.rows("FROM detection WHERE solve = ? ORDER BY used_share, aircraft, wing", [solve])
    columns = _columns("aircraft wing recorder_id frames used_share sigma_px residual_px beyond_share")
    reasons = desk.rows(
        "SELECT reason, sum(markers) AS markers, count(DISTINCT aircraft) AS aircraft FROM marker_reasons WHERE solve = ? "
        "GROUP BY reason ORDER BY markers DESC",
        [solve],
    )
    why = _columns("reason markers aircraft", aircraft=("aircraft", 0, 1))
    return f"<h2>Detection</h2>{table(rows, columns)}<h3>Markers not used</h3>{table(reasons, why, 10)}"


def _failing(desk: Desk, solve: str) -> str:
    rows = desk.rows("FROM failing_flights WHERE solve = ? ORDER BY ok, shots - ok DESC, aircraft, flight", [solve])
    columns = _columns("aircraft recorder_id flight shots ok reason", reason=("most frequent reason", None, 1))
    said = desk.state.failures(solve)
    lost = [
        {"flight": str(flight), "why": said[flight][-1] if flight in said else "no task has finished yet"}
        for flight in desk.state.missing(solve)
    ]
    coming = [
        {"flight": str(flight), "why": f"{desk.state.arrived(flight)}: not completely uploaded yet"}
        for flight in desk.state.flights
        if desk.state.arrived(flight) != "whole"
    ]
    withdrawn = [
        {"flight": str(flight), "why": f"{record['why']} ({record['by']}, {record['at'][:10]})"}
        for flight, one, record in desk.withdrawn()
        if one == solve
    ]
    why = _columns("flight why")
    return (
        f"<h2>Failures</h2><h3>Flights with shots without a result</h3>{table(rows, columns)}"
        f"<h3>Flights without tables of this solve</h3>{table(lost + coming, why)}"
        f"<h3>Withdrawn flights (excluded above)</h3>{table(withdrawn, why)}"
    )


def _live(desk: Desk, solve: str) -> str:
    of = desk.rows("SELECT DISTINCT solve FROM live_by_flight ORDER BY solve <> ?, solve", [solve])
    if not of:
        return ""
    rows = desk.rows("FROM live_by_flight WHERE solve = ? ORDER BY solved_share, began", [of[0]["solve"]])
    columns = _columns(
        "aircraft wing flight results rate_hz solved_share deflection_m scatter_m sigma_m",
        deflection_m=("mean deflection of the tip, m", 3, 1),
        sigma_m=("sigma of a result, mm", 1, 1000),
    )
    caption = "Live results as uploaded; they are not solved again."
    return f'<h2>Live results</h2>{table(rows, columns)}<p class="caption">{caption}</p>'


def _compared(desk: Desk, one: str | None, other: str) -> str:
    if one is None:
        return "<h2>Two solves</h2><p class=soft>There is only one solve.</p>"
    rows = desk.rows(
        "FROM compared_by_aircraft(?, ?) ORDER BY abs(mean_m) DESC NULLS LAST, aircraft, wing", [one, other]
    )
    columns = _columns(
        "aircraft wing frames mean_m rms_m most_m over_sigma won lost",
        frames=("common frames", 0, 1),
        most_m=("maximum, mm", 2, 1000),
        over_sigma=("rms over sigma", 2, 1),
    )
    drawn = [(row["aircraft"], row["wing"]) for row in rows[:DRAWN]]
    points = desk.rows(
        "SELECT aircraft, wing, deflection_one_m AS x, 1000 * difference_m AS y, 1000 * sigma_m AS s FROM compared(?, ?) "
        "WHERE difference_m IS NOT NULL AND list_contains(?, aircraft || ' ' || wing) "
        "ORDER BY hash(recorder_id, flight, series, shot) LIMIT 1500",
        [one, other, list(map(_name, drawn))],
    )
    series = [
        Series(_name(a), [(r["x"], r["y"], r["s"]) for r in points if _name(r) == _name(a)]) for a in sorted(drawn)
    ]
    figure = chart(
        series,
        f"deflection in {one}, m",
        f"{other} minus {one}, mm",
        f"Difference of deflection between {one} and {other}",
    )
    caption = "Deflection of the tip frame by frame; bars: the larger of the two standard deviations. At most 1,500 frames are drawn."
    return f"<h2>Two solves: {html.escape(other)} against {html.escape(one)}</h2>{figure}{_caption(caption, series, 'that differ most')}{table(rows, columns)}"
