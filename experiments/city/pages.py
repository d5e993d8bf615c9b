"""Pages and figures of a city: the report of all junctions, and one for each."""

from collections.abc import Callable, Container, Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from geometry.arrays import FloatArray
from geometry.maps.source_map import SourceMap
from geometry.scene import Scene
from placement.city.fronts import JunctionFront
from placement.layout import Layout

from ..figures.axes import BLUE, VERMILION, WIDTH_IN, Style, finish_axes, new_axes
from ..parts.section import Block, Bullets, Code, Section, build_picture, tabulate
from ..report.page import page_template
from ..results.numbers import euros, number, percent
from ..scene.pictures import HALO, new_map_axes, plot_scene_plan
from .answer import CityFrontRecord, CityJunctionRecord, CityResult

MAX_ROWS = 400
"""Junctions and poles that are listed, and junctions that get pages."""

_MAX_STEPS = 60
_ARROW_M = 9.0
_STAGES = {
    "apr": "accidents prevented",
    "apr_one_failed": "if at each junction the unit needed most fails",
    "smallest_margin_s": "smallest time to spare (s)",
    "mean_margin_s": "mean time to spare (s)",
    "cost_eur": "cost (EUR)",
}


def render_city_report(
    result: CityResult,
    city_map: Axes,
    front: Axes,
    *,
    poles: Sequence[Mapping[str, Any]],
    paged: Container[str],
) -> str:
    """The city's report as one HTML page; it links the pages of the folders that have one."""
    sections = [
        _map_section(result, city_map),
        _junction_section(result, paged),
        _front_section(result, front),
        _proof_section(result),
        _order_section(result, poles),
        _not_done_section(result),
        _assumptions_section(result),
    ]
    names = " and ".join(one.name for one in result.maps if one.has_roads)
    return page_template().render(
        title=f"Roadside units for {names}",
        answer=list(result.sentences),
        sections=[
            *(section for section in sections if section is not None),
            Section("again", "Make it again", [Code(result.command)]),
        ],
        interactive=None,
    )


def _map_section(result: CityResult, city_map: Axes) -> Section:
    picture = build_picture(
        city_map,
        title="What each junction gets",
        caption="Circles grow with the gain and darken with the number of units, which stands in "
        "them. Next to the largest ones is the rank, as in the table below. Streets and buildings "
        "are those of the maps.",
        alt=f"Map with {sum(one.units > 0 for one in result.junctions)} junctions that get units "
        f"and {sum(not one.units for one in result.junctions)} that get none; the table below "
        "lists all of them.",
    )
    return Section("map", "Where", [picture])


def _junction_section(result: CityResult, paged: Container[str]) -> Section:
    served = sorted((one for one in result.junctions if one.units), key=lambda one: -one.gain)
    rank = {one.folder: number for number, one in enumerate(served, start=1)}
    columns: dict[str, Callable[[CityJunctionRecord], object]] = {
        "rank": lambda one: str(rank[one.folder]),
        "junction": lambda one: _link(one, paged),
        "district": lambda one: one.district,
        "units": lambda one: str(one.units),
        "year": lambda one: str(one.year),
        "cost (EUR)": lambda one: f"{one.cost_eur:,.0f}",
        "weight": lambda one: percent(one.weight),
        "APR before": lambda one: percent(one.apr_before),
        "APR": lambda one: percent(one.apr),
        "APR if a unit fails": lambda one: percent(one.apr_one_failed),
        "gain for the city": lambda one: percent(one.gain),
    }
    is_asked = {
        "district": any(one.district for one in served),
        "year": any(one.year for one in served),
        "APR before": result.apr_before > 0.0,
    }
    for name in (name for name, asked in is_asked.items() if not asked):
        del columns[name]
    blocks: list[Block] = []
    if served:
        left = len(served) - MAX_ROWS
        more = f" ({left} more in junctions.csv)" if left > 0 else ""
        caption = f"Junctions that get units, by their gain{more}"
        numeric = range(2 + is_asked["district"], len(columns))
        blocks.append(tabulate(caption, served[:MAX_ROWS], columns, numeric=numeric))
    rest = [one for one in result.junctions if not one.units and not one.reason]
    if rest:
        blocks.append(
            tabulate(
                "Junctions that get nothing",
                rest[:MAX_ROWS],
                {
                    "junction": lambda one: _link(one, paged),
                    "weight": lambda one: percent(one.weight),
                    "APR": lambda one: percent(one.apr),
                },
                summary=f"{len(rest)} junctions get nothing",
                numeric=(1, 2),
            )
        )
    return Section("junctions", "What each junction gets", blocks)


def _link(one: CityJunctionRecord, paged: Container[str]) -> str:
    """The name of a junction that leads to its page, if it has one."""
    if one.folder not in paged:
        return one.label
    return Markup('<a href="{}">{}</a>').format(f"{one.folder}/report.html", one.label)


def _front_section(result: CityResult, front: Axes) -> Section:
    by_cost = result.by == "cost"
    counted, unit = ("euros", " EUR") if by_cost else ("units", "")
    budget = result.budget_eur if by_cost else result.budget_units
    picture = build_picture(
        front,
        title=f"What more {counted} buy",
        caption="Each dot is a step at which a junction joins or gets more, and the best choice "
        "for what it takes. Between two dots other choices are best; made of the layouts found, "
        "none is above the line. Wishes for districts and areas are not counted here.",
        alt=f"Accidents prevented against {counted}, rising from {percent(result.apr_before)}.",
    )
    shown = list(enumerate(result.front[:_MAX_STEPS], start=1))
    within = sum(1 for step in result.front if budget is not None and step.taken <= budget + 1e-6)
    table = tabulate(
        "Steps of the city's front",
        shown,
        {
            "step": lambda one: str(one[0]),
            "junction": lambda one: one[1].junction,
            "units from here on": lambda one: str(one[1].units),
            f"together{unit}": lambda one: f"{one[1].taken:,.0f}",
            "prevented": lambda one: percent(one[1].apr),
        },
        summary=f"The first {len(shown)} steps; {within} of them fit into the budget",
        numeric=(2, 3, 4),
    )
    return Section("front", f"What more {counted} buy", [picture, table])


def _proof_section(result: CityResult) -> Section:
    table = tabulate(
        "Objectives in order; each holds those above it",
        result.stages,
        {
            "objective": lambda stage: _STAGES[stage.name],
            "found": lambda stage: _shown(stage.name, stage.objective),
            "bound": lambda stage: _shown(stage.name, stage.bound),
            "gap": lambda stage: "proven" if stage.gap == 0.0 else "open",
        },
        numeric=(1, 2),
    )
    note = (
        "The first bound holds for all layouts at all junctions: it is made of the bounds of the "
        "junctions' fronts and of the choice among them. The others hold for the choice among the "
        f"points of the fronts, of which none exceeds {percent(result.bound_of_fronts)} in the "
        f"first objective. Solver: {result.solver}."
    )
    return Section("proof", "How good it is proven to be", [table, note])


def _shown(objective: str, value: float | None) -> str:
    if value is None:
        return number(None)
    if objective.startswith("apr"):
        return percent(value)
    return f"{value:,.0f}" if objective == "cost_eur" else number(value)


def _order_section(result: CityResult, poles: Sequence[Mapping[str, Any]]) -> Section | None:
    if not result.purchases:
        return None
    order = tabulate(
        "To order",
        result.purchases,
        {
            "part": lambda one: one.part,
            "what": lambda one: one.name,
            "number": lambda one: str(one.count),
            "sum (EUR)": lambda one: f"{one.sum_eur:,.0f}" if one.sum_eur else "unknown",
        },
        numeric=(2, 3),
    )
    columns: dict[str, Callable[[Mapping[str, Any]], object]] = {
        "junction": lambda pole: str(pole["name"] or pole["junction"]),
        "pole": lambda pole: str(pole["site"]),
        "kind": lambda pole: str(pole["kind"]),
        "units": lambda pole: str(pole["units"]),
    }
    if all("map_x" in pole for pole in poles):
        columns["x"] = lambda pole: f"{pole['map_x']:.6f}"
        columns["y"] = lambda pole: f"{pole['map_y']:.6f}"
    summary = f"{len(poles)} poles that carry units"
    listed = tabulate("Poles", poles[:MAX_ROWS], columns, summary=summary, numeric=(3, 4, 5))
    note = (
        "Prices are those of the catalogue; sites without a known price have those that "
        "placement/data/prices.toml assumes. All units are in city.gpkg, all poles in poles.csv."
    )
    return Section("order", "What to order", [order, listed, note])


def _not_done_section(result: CityResult) -> Section | None:
    failed = [one for one in result.junctions if one.reason]
    table = tabulate(
        "Junctions without a front",
        failed[:MAX_ROWS],
        {
            "junction": lambda one: one.label,
            "weight": lambda one: percent(one.weight),
            "why": lambda one: one.reason,
        },
        numeric=(1,),
    )
    return Section("not-done", "What was not done", [table]) if failed else None


def _assumptions_section(result: CityResult) -> Section:
    search = result.search
    sentences = [
        f"Weights: {result.weights}.",
        f"Poses at each site: {search.poses}; at most {search.max_units} new units at a junction, "
        f"{search.max_junction_seconds:g} s for each; sites: {search.sites}; "
        f"{search.radius_m:g} m around each junction.",
        "Junctions do not help one another: a unit counts at the junction that it was chosen for.",
        "Each APR is that of the detection table; the page of a junction has the command that "
        "evaluates its units by full perception and braking.",
        *result.notes,
    ]
    return Section("assumptions", "What this rests on", [Bullets(sentences)])


def render_junction_page(
    one: CityJunctionRecord, record: CityFrontRecord, scene: Scene, layout: Layout, *, question: str
) -> str:
    """The page of a junction: its units, its front, and how to look closer.

    `question` is the name of the file of the runs that are driven, in the page's folder.
    """
    again = f"place-rsus evaluate --scene . --layout layout.json --question {question} --out report"
    answer = [
        f"{one.units} new units for {euros(one.cost_eur)}: APR {percent(one.apr)}"
        + (f", before {percent(one.apr_before)}." if one.kept else ".")
        if one.units
        else "This junction gets no new unit.",
        f"{record.runs} runs, {record.sites} sites, {record.poses} poses.",
    ]
    sections = [
        Section("plan", "Plan", _plan_blocks(one, scene, layout)),
        Section("front", "What money buys here", _front_blocks(one, record)),
        Section(
            "closer",
            "Look closer",
            ["In this folder, full perception and emergency braking:", Code(again)],
        ),
    ]
    if record.notes:
        sections.append(Section("notes", "Left out or assumed", [Bullets(record.notes[:60])]))
    return page_template().render(
        title=one.label, answer=answer, sections=sections, interactive=None
    )


def _plan_blocks(one: CityJunctionRecord, scene: Scene, layout: Layout) -> list[Block]:
    plan = plot_scene_plan(scene)
    for unit in layout.units:
        x, y = unit.pose.position_m[:2]
        yaw = np.radians(unit.pose.yaw_deg)
        plan.annotate(
            "",
            xy=(x + _ARROW_M * np.cos(yaw), y + _ARROW_M * np.sin(yaw)),
            xytext=(x, y),
            arrowprops={"arrowstyle": "-|>", "color": VERMILION, "linewidth": 2.0},
            zorder=10,
        )
        plan.plot([x], [y], marker="o", ms=7.0, mfc=VERMILION, mec="black", mew=0.6, zorder=11)
    picture = build_picture(
        plan,
        title="Plan",
        caption="Sites, and the units that are chosen, with the direction in which they look.",
        alt=f"Plan of {one.label} with {len(one.layout)} units.",
    )
    table = tabulate(
        "Units",
        one.layout,
        {
            "unit": lambda unit: unit.id,
            "site": lambda unit: unit.site,
            "east (m)": lambda unit: number(unit.x_m),
            "north (m)": lambda unit: number(unit.y_m),
            "height (m)": lambda unit: number(unit.z_m),
            "yaw (deg)": lambda unit: number(unit.yaw_deg, 0),
            "pitch (deg)": lambda unit: number(unit.pitch_deg, 0),
        },
        numeric=range(2, 7),
    )
    return [picture, table]


def _front_blocks(one: CityJunctionRecord, record: CityFrontRecord) -> list[Block]:
    assert record.front is not None
    points = record.front.points
    chosen = next(
        index
        for index, point in enumerate(points)
        if (point.units, point.cost_eur, point.apr) == (one.units, one.cost_eur, one.apr)
    )
    front = build_picture(
        plot_junction_front(record.front, chosen=chosen),
        title="What money buys here",
        caption="Layouts found, and the upper bound of all.",
        alt="APR against cost; the table below has the numbers.",
    )
    table = tabulate(
        "Layouts",
        points,
        {
            "new units": lambda point: str(point.units),
            "cost (EUR)": lambda point: f"{point.cost_eur:,.0f}",
            "APR": lambda point: percent(point.apr),
            "APR if a unit fails": lambda point: percent(point.apr_one_failed),
            "chosen": lambda point: "yes" if point is points[chosen] else "",
        },
        numeric=(0, 1, 2, 3),
    )
    return [front, table]


_AREA_PT2 = (70.0, 380.0)  # of the smallest and the largest circle
_MAX_NAMED = 12
_DOT: Style = {"linestyle": "none", "marker": "o"}
_CHOSEN: Style = {
    **{"linestyle": "none", "marker": "D", "ms": 7.5, "mfc": VERMILION, "mec": "black", "mew": 0.6},
    **{"label": "chosen", "gid": "chosen", "zorder": 5},
}


def plot_city_map(
    maps: Sequence[SourceMap], positions_m: Sequence[FloatArray], result: CityResult
) -> Axes:
    """Streets and buildings of the maps, and what each junction gets.

    `positions_m`, (2,) of each junction of `result`, are in the first map's coordinates. Circles
    grow with the gain and darken with the number of units, which stands in them. A small open
    circle gets nothing, a cross was not done.
    """
    places, junctions = np.array(positions_m).reshape(-1, 2), result.junctions
    axes = new_map_axes(maps, places)
    gain = np.array([max(one.gain, 0.0) for one in junctions])
    units = np.array([one.units for one in junctions])
    failed = np.array([bool(one.reason) for one in junctions])
    served = units > 0
    most = max(int(units.max(initial=1)), 1)
    size = _AREA_PT2[0] + (_AREA_PT2[1] - _AREA_PT2[0]) * gain / max(gain.max(initial=0.0), 1e-12)
    order = np.flatnonzero(served)[np.argsort(-size[served], kind="stable")]

    def shade(n: int) -> Any:
        # Light to dark: a lightness that falls evenly is read without colours, too.
        return colormaps["cividis_r"](0.15 + 0.85 * n / most)

    for index in order:
        axes.scatter(
            places[index, 0],
            places[index, 1],
            s=size[index],
            color=shade(units[index]),
            edgecolor="black",
            linewidth=0.6,
            zorder=5,
            gid=f"junction {junctions[index].id}",
        )
        dark = units[index] > 0.45 * most
        _write(axes, units[index], places[index], fontsize=6.5, color="white" if dark else "black")
    for rank, index in enumerate(order[:_MAX_NAMED], start=1):
        away = (0.6 * np.sqrt(size[index]) + 1.0, 4.0)
        style: Style = {"fontsize": 7.5, "fontweight": "bold", "color": BLUE, "ha": "left"}
        _write(axes, rank, places[index], xytext=away, va="baseline", path_effects=[HALO], **style)
    circle: Style = {**_DOT, "ms": 7.0, "mec": "black", "mew": 0.6}
    handles = [
        Line2D([], [], mfc=shade(n), label=f"{n} unit{'s' if n > 1 else ''}", **circle)
        for n in sorted(set(units[served].tolist()))
    ]
    for mask, style in (
        (
            ~served & ~failed,
            {**_DOT, "mfc": "white", "mec": "#444444", "mew": 0.9, "ms": 4.0, "label": "nothing"},
        ),
        (
            failed,
            {**_DOT, "marker": "x", "mec": VERMILION, "mew": 1.4, "ms": 5.0, "label": "not done"},
        ),
    ):
        if mask.any():
            handles += axes.plot(*places[mask].T, zorder=4, **style)
    axes.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.01),
        ncols=min(max(len(handles), 1), 6),
        fontsize=7.5,
        frameon=False,
    )
    return axes


def _write(axes: Axes, number: int, place: FloatArray, **style: Any) -> None:
    at: Style = {"xytext": (0.0, 0.0), "textcoords": "offset points", "zorder": 7}
    axes.annotate(str(number), tuple(place), **{"ha": "center", "va": "center", **at, **style})


def plot_city_front(result: CityResult) -> Axes:
    """Prevented accidents against money or units: who joins, and where the budget ends.

    Each dot is the best choice for its cost. The diamond is the choice for the budget; above it,
    the bound where that is higher.
    """
    axes = new_axes(WIDTH_IN, 3.2)
    by_cost = result.by == "cost"
    x = [0.0, *(step.taken for step in result.front)]
    y = [100.0 * result.apr_before, *(100.0 * step.apr for step in result.front)]
    axes.plot(x, y, color=BLUE, lw=1.0, zorder=2)
    axes.plot(x, y, ms=3.5, color=BLUE, zorder=3, gid="steps", **_DOT)
    taken = result.cost_eur if by_cost else float(result.units)
    stage = result.stages[0]
    axes.plot([taken], [100.0 * stage.objective], **_CHOSEN)
    if stage.bound is not None and stage.gap:
        bar: Style = {"linestyle": "none", "marker": "_", "ms": 12.0, "mec": VERMILION, "mew": 2.0}
        axes.vlines(taken, 100.0 * stage.objective, 100.0 * stage.bound, color=VERMILION, lw=2.0)
        axes.plot([taken], [100.0 * stage.bound], label="no choice is above", **bar)
    budget = result.budget_eur if by_cost else result.budget_units
    if budget is not None:
        axes.axvline(budget, color="black", lw=0.8, linestyle=(0, (2, 2)), label="budget")
    axes.set_ylim(0.0, 104.0)
    axes.set_xlim(left=0.0)
    label = "cost of units and sites (EUR)" if by_cost else "new units"
    return _finish_front(axes, label, "accidents prevented (%)", by_cost=by_cost)


def plot_junction_front(front: JunctionFront, *, chosen: int) -> Axes:
    """APR against money at one junction: points with their units, bounds, the one chosen."""
    axes = new_axes(WIDTH_IN, 2.8)
    cost = [point.cost_eur for point in front.points]
    apr_percent = [100.0 * point.apr for point in front.points]
    end = 1.1 * max(*cost, 1.0)
    axes.plot(
        [start for start, _ in front.by_cost] + [end],
        [100.0 * bound for _, bound in (*front.by_cost, front.by_cost[-1])],
        drawstyle="steps-post",
        color="#777777",
        lw=1.0,
        linestyle=(0, (3, 2)),
        label="no layout is above",
    )
    axes.plot(cost, apr_percent, ms=5.0, color=BLUE, label="layouts", gid="points", **_DOT)
    for x, y, point in zip(cost, apr_percent, front.points, strict=True):
        _write(axes, point.units, np.array([x, y]), xytext=(0.0, -9.0), va="baseline", fontsize=6.5)
    axes.plot([cost[chosen]], [apr_percent[chosen]], **_CHOSEN)
    axes.set_ylim(-8.0, 104.0)
    axes.set_xlim(-0.03 * end, end)
    return _finish_front(axes, "cost (EUR); below each point its units", "APR (%)", by_cost=True)


def _finish_front(axes: Axes, x: str, y: str, *, by_cost: bool) -> Axes:
    finish_axes(axes, x=x, y=y, grid="y")
    if by_cost:
        axes.xaxis.set_major_formatter(lambda value, _position: f"{value:,.0f}")
    axes.legend(fontsize=8, frameon=False, loc="lower right")
    return axes
