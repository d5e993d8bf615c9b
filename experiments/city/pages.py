"""Pages and figures of a city: the report of all junctions, and one for each."""

from collections.abc import Container, Mapping, Sequence
from functools import cache, partial
from importlib.resources import files
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from geometry.arrays import FloatArray
from geometry.maps.source_map import SourceMap
from geometry.scene import Scene
from placement.city.fronts import JunctionFront
from placement.layout import Layout
from placement.optimiser.constants import TOLERANCE

from ..figures.axes import (
    BLUE,
    VERMILION,
    WIDTH_IN,
    Style,
    finish_axes,
    new_axes,
)
from ..figures.labels import TextLabel, draw_labels
from ..language import localized, tr, trn
from ..parts.section import Bullets, Code, Section, build_picture
from ..report.page import page_environment, page_template
from ..results.numbers import euros, joined, number, percent, points
from ..scene.pictures import build_street_map, new_map_axes, plot_scene_plan
from .answer import CityFrontRecord, CityJunctionRecord, CityResult, says

MAX_ROWS = 400
"""Junctions and poles that are listed, and junctions that get pages."""

_MAX_STEPS = 60
# Euros, or units.
_SAME = 0.5
_ARROW_M = 9.0


@cache
def _templates() -> Any:
    """Sections of the pages, as macros by the ids of the sections."""
    source = (files(__package__) / "sections.html.j2").read_text(encoding="utf-8")
    words = {
        **{"percent": percent, "euros": euros, "number": number, "most": MAX_ROWS},
        "points": points,
        "joined": lambda numbers: joined([str(number) for number in numbers]),
        "undone": partial(says, "undone"),
        "whole": lambda value: localized(f"{value:,.0f}"),
    }
    return page_environment().from_string(source, globals=words).module


def _section(name: str, title: str, *values: object, macro: str = "") -> Section:
    html = getattr(_templates(), macro or name.replace("-", "_"))(*values)
    return Section(name, title, [html] if html else [])


def render_city_report(
    result: CityResult,
    city_map: Axes,
    narrow_map: Axes,
    front: Axes,
    *,
    sums: Mapping[str, Any],
    poles: Sequence[Mapping[str, Any]],
    paged: Container[str],
) -> str:
    """The city's report as one HTML page.

    It links the pages of the folders that have one.
    """
    by_cost = result.by == "cost"
    if by_cost:
        budget = result.budget_eur
    else:
        budget = result.budget_units
    steps = result.front[:_MAX_STEPS]
    n_within = 0
    if budget is not None:
        n_within = sum(step.taken <= budget + 1e-6 for step in result.front)
    failed = [one for one in result.junctions if one.reason]
    if by_cost:
        more = tr("What more money buys")
    else:
        more = tr("What more sensors buy")
    sections = [
        _section("junctions", tr("What each junction gets"), result, paged),
        _section(
            "front", more, result, partial(build_picture, front), steps, n_within, sums
        ),
        _section("proof", tr("What is proven"), result),
        *(
            [_section("order", tr("What to order"), result, poles)]
            if result.purchases
            else []
        ),
        *([_section("not-done", tr("What was not done"), failed)] if failed else []),
        _section("assumptions", tr("Basis of these results"), result, result.search),
        Section("again", tr("Reproduce this result"), [Code(result.command)]),
    ]
    return page_template().render(
        title=tr("Roadside sensors for {maps}", maps=result.map_names),
        overview=_templates().overview(
            result, partial(build_picture, city_map, narrow=narrow_map)
        ),
        answer=list(result.sentences[1:]),
        sections=sections,
        interactive=None,
    )


def build_sums(
    maps: Sequence[SourceMap], positions_m: Sequence[FloatArray], result: CityResult
) -> dict[str, Any]:
    """What each sum of money or number of sensors buys.

    For a slider beside a map of streets.

    ``stops`` are the steps of the city's front and the choice itself: what each says,
    and what it changes at junctions, by their index, against the stop before. ``spots``
    are the places of these in the map: metres from its upper left corner.
    """
    places = np.array(positions_m).reshape(-1, 2)
    streets, placed = build_street_map(maps, places)
    spots = placed(places)
    index = {one.folder: number for number, one in enumerate(result.junctions)}
    is_done = sum(one.weight for one in result.junctions if not one.reason)
    got: dict[int, int] = {}
    states = [(0.0, result.apr_before, got)]
    for step in result.front:
        got = got | {index[step.folder]: step.units}
        states.append((step.taken, step.apr, got))
    chosen = {
        number: one.units for number, one in enumerate(result.junctions) if one.units
    }
    if result.by == "cost":
        own = result.cost_eur
    else:
        own = float(result.units)
    best = result.stages[0].objective
    states = [
        one for one in states if abs(one[0] - own) > _SAME or one[1] > best + TOLERANCE
    ]
    states = sorted([*states, (own, best, chosen)], key=lambda one: one[:2])
    stops: list[dict[str, Any]] = []
    before: dict[int, int] = {}
    for taken, apr, now in states:
        sets = {
            key: now.get(key, 0)
            for key in before | now
            if now.get(key) != before.get(key)
        }
        at = {
            "taken": taken,
            "share": is_done * apr,
            "n": sum(now.values()),
            "served": len(now),
        }
        stops.append({**at, "sets": sets, "is_chosen": now is chosen})
        before = now
    used = sorted({number for stop in stops for number in stop["sets"]})
    return {
        "streets": streets | {"names": [], "junctions": []},
        "stops": stops,
        "shown": {
            "spots": {number: spots[number].tolist() for number in used},
            "names": {number: result.junctions[number].label for number in used},
        },
        "chosen": next(n for n, one in enumerate(stops) if one["is_chosen"]),
    }


def render_junction_page(
    one: CityJunctionRecord,
    record: CityFrontRecord,
    scene: Scene,
    layout: Layout,
    *,
    question: str,
) -> str:
    """The page of a junction: its units, its front, and how to look closer.

    `question` is the name of the file of the runs that are driven, in the page's
    folder.
    """
    again = (
        "place-rsus evaluate --scene . --layout layout.json --question"
        f" {question} --out report"
    )
    assert record.front is not None
    points = record.front.points
    chosen = next(
        index
        for index, point in enumerate(points)
        if (point.units, point.cost_eur, point.apr)
        == (one.units, one.cost_eur, one.apr)
    )
    plan = partial(build_picture, _plot_units(scene, layout))
    front = partial(build_picture, plot_junction_front(record.front, chosen=chosen))
    look = tr("In this folder, full perception and emergency braking:")
    sections = [
        _section("plan", tr("Plan"), one, plan),
        _section(
            "front",
            tr("What money buys here"),
            points,
            points[chosen],
            front,
            macro="layouts",
        ),
        Section("closer", tr("Look closer"), [look, Code(again)]),
    ]
    if scene.notes:
        notes = Bullets([tr(note.words) for note in scene.notes[:60]])
        sections.append(Section("notes", tr("Left out or assumed"), [notes]))
    return page_template().render(
        title=one.label,
        answer=[_templates().gets(one), _templates().sizes(record)],
        sections=sections,
        interactive=None,
    )


def _plot_units(scene: Scene, layout: Layout) -> Axes:
    """Plan of a scene with its sites, and where each unit stands and looks."""
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
        plan.plot(
            [x], [y], marker="o", ms=7.0, mfc=VERMILION, mec="black", mew=0.6, zorder=11
        )
    return plan


# Of the smallest and the largest circle.
_AREA_PT2 = (70.0, 380.0)
_MAX_NAMED = 12
# Of names, counts and the key on the map of a city.
_NAME_PT = 12.0
_DOT: Style = {"linestyle": "none", "marker": "o"}
_CHOSEN: Style = {
    **{
        "linestyle": "none",
        "marker": "D",
        "ms": 7.5,
        "mfc": VERMILION,
        "mec": "black",
        "mew": 0.6,
    },
    **{"gid": "chosen", "zorder": 5},
}


def plot_city_map(
    maps: Sequence[SourceMap],
    positions_m: Sequence[FloatArray],
    result: CityResult,
    *,
    width_in: float = WIDTH_IN,
) -> Axes:
    """Streets and buildings of the maps, and what each junction gets.

    `positions_m`, (2,) of each junction of `result`, are in the first map's
    coordinates. Circles grow with the gain and darken with the number of units, which
    stands in them. A small open circle gets nothing, a cross was not done.
    """
    places = np.array(positions_m).reshape(-1, 2)
    junctions = result.junctions
    # The wide figure stands in half of a page.
    scale = max(width_in / WIDTH_IN, 0.7)
    axes = new_map_axes(maps, places, width_in=width_in)
    gain = np.array([max(one.gain, 0.0) for one in junctions])
    units = np.array([one.units for one in junctions])
    failed = np.array([bool(one.reason) for one in junctions])
    served = units > 0
    most = max(int(units.max(initial=1)), 1)
    size = _AREA_PT2[0] + (_AREA_PT2[1] - _AREA_PT2[0]) * gain / max(
        gain.max(initial=0.0), 1e-12
    )
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
        _write(
            axes,
            units[index],
            places[index],
            fontsize=9.0 * scale,
            color="white" if dark else "black",
        )
    names = [
        TextLabel(
            text=f"{rank} {junctions[index].label}",
            point_m=(float(places[index, 0]), float(places[index, 1])),
            gap=0.6 * float(np.sqrt(size[index])),
            size=_NAME_PT * scale,
            style={"color": BLUE, "zorder": 8},
        )
        for rank, index in enumerate(order[:_MAX_NAMED], start=1)
    ]
    draw_labels(axes, names, marks_m=places)
    circle: Style = {**_DOT, "ms": 7.0, "mec": "black", "mew": 0.6}
    handles = [
        Line2D(
            [], [], mfc=shade(n), label=trn("{n} sensor", "{n} sensors", n), **circle
        )
        for n in sorted(set(units[served].tolist()))
    ]
    nothing = {
        "mfc": "white",
        "mec": "#444444",
        "mew": 0.9,
        "ms": 4.0,
        "label": tr("nothing"),
    }
    crossed = {
        "marker": "x",
        "mec": VERMILION,
        "mew": 1.4,
        "ms": 5.0,
        "label": tr("left out"),
    }
    for mask, style in ((~served & ~failed, nothing), (failed, crossed)):
        if mask.any():
            handles += axes.plot(*places[mask].T, zorder=4, **{**_DOT, **style})
    axes.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.01),
        ncols=min(max(len(handles), 1), 6),
        fontsize=_NAME_PT * scale,
        frameon=False,
    )
    return axes


def _write(axes: Axes, number: int, place: FloatArray, **style: Any) -> None:
    at: Style = {"xytext": (0.0, 0.0), "textcoords": "offset points", "zorder": 7}
    axes.annotate(
        str(number), tuple(place), **{"ha": "center", "va": "center", **at, **style}
    )


def plot_city_front(result: CityResult) -> Axes:
    """Prevented accidents against money or units: who joins, and where the budget ends.

    Each dot is the best choice for its cost. The diamond is the choice for the budget;
    above it, the bound where that is higher.
    """
    axes = new_axes(WIDTH_IN, 3.2)
    by_cost = result.by == "cost"
    x = [0.0, *(step.taken for step in result.front)]
    y = [100.0 * result.apr_before, *(100.0 * step.apr for step in result.front)]
    axes.plot(x, y, color=BLUE, lw=1.0, zorder=2)
    axes.plot(x, y, ms=3.5, color=BLUE, zorder=3, gid="steps", **_DOT)
    if by_cost:
        taken = result.cost_eur
    else:
        taken = float(result.units)
    stage = result.stages[0]
    axes.plot([taken], [100.0 * stage.objective], label=tr("chosen"), **_CHOSEN)
    if stage.bound is not None and stage.gap:
        bar: Style = {
            "linestyle": "none",
            "marker": "_",
            "ms": 12.0,
            "mec": VERMILION,
            "mew": 2.0,
        }
        axes.vlines(
            taken, 100.0 * stage.objective, 100.0 * stage.bound, color=VERMILION, lw=2.0
        )
        axes.plot([taken], [100.0 * stage.bound], label=tr("upper bound"), **bar)
    if by_cost:
        budget = result.budget_eur
    else:
        budget = result.budget_units
    if budget is not None:
        dotted: Style = {"color": "black", "lw": 0.8, "linestyle": (0, (2, 2))}
        axes.axvline(budget, label=tr("budget"), **dotted)
    axes.set_ylim(0.0, 104.0)
    axes.set_xlim(left=0.0)
    if by_cost:
        label = tr("cost of sensors and poles (EUR)")
    else:
        label = tr("new sensors")
    return _finish_front(axes, label, tr("prevented (%)"), by_cost=by_cost)


def plot_junction_front(front: JunctionFront, *, chosen: int) -> Axes:
    """APR against money at one junction.

    Points with their units, bounds, the one chosen.
    """
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
        label=tr("upper bound"),
    )
    axes.plot(
        cost, apr_percent, ms=5.0, color=BLUE, label=tr("layouts"), gid="points", **_DOT
    )
    for x, y, point in zip(cost, apr_percent, front.points, strict=True):
        _write(
            axes,
            point.units,
            np.array([x, y]),
            xytext=(0.0, -9.0),
            va="baseline",
            fontsize=6.5,
        )
    axes.plot([cost[chosen]], [apr_percent[chosen]], label=tr("chosen"), **_CHOSEN)
    axes.set_ylim(-8.0, 104.0)
    axes.set_xlim(-0.03 * end, end)
    label = tr("cost (EUR); below each point its sensors")
    return _finish_front(axes, label, tr("prevented (%)"), by_cost=True)


def _finish_front(axes: Axes, x: str, y: str, *, by_cost: bool) -> Axes:
    finish_axes(axes, x=x, y=y, grid="y")
    if by_cost:
        axes.xaxis.set_major_formatter(lambda value, _: localized(f"{value:,.0f}"))
    axes.legend(fontsize=8, frameon=False, loc="lower right")
    return axes
