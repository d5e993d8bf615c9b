"""Where it is still dangerous.

Runs that nobody avoids, by case and place, and their map.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize

from geometry.arrays import BoolArray, FloatArray, IntArray
from placement.evaluation import Evaluation
from placement.layout import Layout
from placement.setting import Setting
from scenarios.positions import AT_ZERO, read_position
from scenarios.runs import FrameAxis
from scenarios.weights import weight_share

from ..figures.axes import (
    NARROW_IN,
    WIDTH_IN,
    Style,
    new_axes,
    root_figure,
    show_square,
)
from ..figures.plan import draw_scene
from ..language import tr, trn
from ..results.numbers import joined, percent
from ..results.record import Record, says
from ..results.tables import RunGroup, groups_by
from .accidents import is_weighted
from .section import Block, Box, Section, Table, build_picture

_MAX_GROUPS = 3
SHADES = LinearSegmentedColormap.from_list("left over", ["#303030", "#ffffff"])
"""Of shares that are avoided: the more accidents are left, the darker."""
# From there white and black letters stand out alike.
_DARK_BELOW = 0.34
# Across: less than from one lane to the oncoming one.
_SAME_PLACE_M = 6.0
_BORDER_M = 8.0
_MIN_HALF_SIZE_M = 30.0
_RED: Style = {
    "markerfacecolor": "#CC0000",
    "markeredgecolor": "white",
    "markeredgewidth": 0.6,
}
_UNIT_STYLE: Style = _RED | {"markersize": 7.0, "linestyle": "none"}


class DangerGroup(Record, frozen=True, kw_only=True):
    """Some runs that are alike, and how many of them are not avoided."""

    name: Annotated[str, says("Of the case, or of the position along the arms.")]
    runs: Annotated[int, says("How many.")]
    not_avoided: Annotated[int, says("How many of them are not avoided.")]


class Dangers(Record, frozen=True, kw_only=True):
    """Runs that the units of the layout do not avoid, by the evaluator."""

    not_avoided: Annotated[int, says("How many of all runs.")]
    by_case: Annotated[
        tuple[DangerGroup, ...], says("Largest share of runs left first.")
    ]
    by_position: Annotated[
        tuple[DangerGroup, ...], says("The same by position; empty: only one.")
    ]


def avoided_runs(evaluation: Evaluation, fusion: str) -> BoolArray:
    """Runs (n_runs,) that the units avoid, as they were chosen to.

    With fusion "single" some unit has to confirm by itself; else any may detect in each
    frame. The VUT is one of them where every VUT sees.
    """
    if fusion != "single":
        return evaluation.headline.is_avoided
    parties = [
        *evaluation.units.values(),
        *([evaluation.vut] if evaluation.cars == 1.0 else []),
    ]
    alone: BoolArray = np.any([party.is_avoided for party in parties], axis=0)
    return alone


def build_dangers(is_avoided: BoolArray, axis: FrameAxis) -> Dangers:
    """Runs that are not avoided, counted by case and position.

    Weights do not matter.
    """
    positions = groups_by(axis, "position")
    return Dangers(
        not_avoided=int((~is_avoided).sum()),
        by_case=_groups(groups_by(axis, "case"), is_avoided),
        by_position=_groups(positions, is_avoided) if len(positions) > 1 else (),
    )


def _groups(
    groups: Sequence[RunGroup], is_avoided: BoolArray
) -> tuple[DangerGroup, ...]:
    records = [
        DangerGroup(
            name=name, runs=int(mask.sum()), not_avoided=int((mask & ~is_avoided).sum())
        )
        for name, mask in groups
    ]
    # Stable: of equal shares the first group comes first.
    return tuple(sorted(records, key=lambda group: -group.not_avoided / group.runs))


def words(dangers: Dangers, n_runs: int, *, cars: float = 0.0) -> list[str]:
    """How many runs are not avoided, and which.

    `cars` is the share of cars that see.
    """
    n_left = dangers.not_avoided
    whose = ""
    if 0.0 < cars < 1.0:
        whose = tr(" for cars that rely on the roadside alone")
    if not n_left:
        return [tr("All {n} runs are avoided{whose}.", n=n_runs, whose=whose)]
    others = tr("in other cases")
    where = _most_left(dangers.by_case, lambda name: tr("in {case}", case=name), others)
    if dangers.by_position:
        places = _most_left(dangers.by_position, position_words, tr("elsewhere"))
        where = tr("{cases}. By place: {places}", cases=where, places=places)
    return [
        trn(
            "{n} of {all} runs (simulated collisions) is not avoided{whose}: {where}.",
            "{n} of {all} runs (simulated collisions) are not avoided{whose}: {where}.",
            n_left,
            all=n_runs,
            whose=whose,
            where=where,
        )
    ]


def position_words(name: str) -> str:
    """A position along the arms in words.

    "15 m before the junction" and the like.
    """
    position = read_position(name, "position")
    if position == AT_ZERO:
        return tr("at the junction")
    if position.distance_m == 0.0:
        return tr("at the crosswalk ahead")
    if position.is_behind:
        return tr(
            "{distance:g} m beyond the crosswalk ahead", distance=position.distance_m
        )
    return tr("{distance:g} m before the junction", distance=position.distance_m)


def _most_left(
    groups: Sequence[DangerGroup], words_of: Callable[[str], str], others: str
) -> str:
    """The groups with the largest share that is left.

    Then how many runs are left in all others.
    """
    left = [group for group in groups if group.not_avoided]
    words = [
        tr(
            "{where} {n} of {all}",
            where=words_of(group.name),
            n=group.not_avoided,
            all=group.runs,
        )
        for group in left[:_MAX_GROUPS]
    ]
    n_others = sum(group.not_avoided for group in left[_MAX_GROUPS:])
    return joined([*words, *([f"{others} {n_others}"] if n_others else [])])


def section(
    setting: Setting, shown: Mapping[str, Evaluation], *, fusion: str
) -> Section:
    """Which places stay dangerous; layouts by display name.

    Drawn are the first one, which was chosen with this fusion, and the last one.
    """
    names = dict.fromkeys([next(iter(shown)), [*shown][-1]])
    avoided = {
        name: avoided_runs(shown[name], "any" if order else fusion)
        for order, name in enumerate(names)
    }
    places = find_places(setting)
    pictures = []
    for name, mask in avoided.items():
        drawn = plot_dangers(
            setting, shown[name].layout, mask, places=places, width_in=NARROW_IN
        )
        n_left = sum(
            place.share_avoided(mask, setting.axis.weight) < 1.0 for place in places
        )
        picture = build_picture(
            drawn,
            title=tr("Where it is still dangerous with {name}", name=name),
            caption=tr(
                "Places with runs that are not avoided: {n} of {all}.",
                n=n_left,
                all=len(places),
            ),
            alt=tr(
                "The junction from above: {all} places, {n} of them with runs that"
                " are not avoided. The tables below list the shares by position.",
                n=n_left,
                all=len(places),
            ),
        )
        pictures.append(picture)
    if is_weighted(setting.axis):
        note = tr(
            "Each mark is a place where runs end in an impact if nobody brakes;"
            " impacts at most 6 m apart share a place. The number is the percentage"
            " of its runs, by weight, that the units avoid; a darker mark means a"
            " lower percentage. At small white squares, all runs are avoided."
            " Triangles are units; rings are sites that could carry units."
        )
    else:
        note = tr(
            "Each mark is a place where runs end in an impact if nobody brakes;"
            " impacts at most 6 m apart share a place. The number is the percentage"
            " of its runs that the units avoid; a darker mark means a lower"
            " percentage. At small white squares, all runs are avoided. Triangles"
            " are units; rings are sites that could carry units."
        )
    blocks: list[Block] = [note, Box("beside" if len(pictures) > 1 else "", pictures)]
    if len(groups_by(setting.axis, "position")) > 1:
        of_subject, *of_others = [
            position_table(name, mask, setting.axis) for name, mask in avoided.items()
        ]
        blocks.append(of_subject)
        blocks += [replace(table, summary=table.caption) for table in of_others]
    return Section("dangers", tr("Where it is still dangerous"), blocks)


def position_table(name: str, is_avoided: BoolArray, axis: FrameAxis) -> Table:
    """Share of the runs that a layout avoids, by position and approach.

    A row for each position as the car passes them, with how many of its runs are
    avoided.
    """
    approaches = groups_by(axis, "direction")

    def share(mask: BoolArray) -> str:
        return percent(weight_share(is_avoided, axis.weight * mask))

    rows = []
    for position, at in groups_by(axis, "position"):
        avoided = tr("{n} of {all}", n=int((is_avoided & at).sum()), all=int(at.sum()))
        each = [share(at & of_approach) for _, of_approach in approaches]
        rows.append([position_words(position), share(at), avoided, *each])
    return Table(
        caption=tr(
            "Share of runs that {name} avoids, by position along the arms", name=name
        ),
        columns=[
            *(tr("where"), tr("APR"), tr("runs avoided")),
            *(tr("from the {arm}", arm=tr(arm)) for arm, _ in approaches),
        ],
        rows=rows,
        numeric=range(1, 3 + len(approaches)),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImpactPlace:
    """Where some runs end in an impact if nobody brakes.

    Attributes
    ----------
    position_m : (2,) float
        Middle of the road users then. World frame. [m]
    runs : (n,) int
        Indices of the runs.
    """

    # (2,): middle of the road users then. World frame. [m]
    position_m: FloatArray
    # (n,): indices of the runs.
    runs: IntArray

    def share_avoided(self, is_avoided: BoolArray, weight: FloatArray) -> float:
        """Share of these runs that is avoided, by weight; NaN if none has any."""
        return weight_share(is_avoided[self.runs], weight[self.runs])


def find_places(setting: Setting) -> tuple[ImpactPlace, ...]:
    """Places of all impacts: those at most 6 m from one another are one place.

    Complete linkage: no two impacts of a place are farther apart. Places are in the
    order in which their runs first appear.
    """
    from scipy.cluster.hierarchy import fcluster, linkage

    points = np.array([run.vru_position_m[-1] for run in setting.runs])
    labels: IntArray = np.ones(len(points), dtype=np.int64)
    if len(points) > 1:
        tree = linkage(points, "complete")
        labels = fcluster(tree, _SAME_PLACE_M, criterion="distance").astype(np.int64)
    return tuple(
        ImpactPlace(
            position_m=points[labels == label].mean(axis=0),
            runs=np.flatnonzero(labels == label),
        )
        for label in dict.fromkeys(labels.tolist())
    )


def plot_dangers(
    setting: Setting,
    layout: Layout,
    is_avoided: BoolArray,
    *,
    places: Sequence[ImpactPlace] | None = None,
    width_in: float = WIDTH_IN,
) -> Axes:
    """The junction from above with the share of runs avoided at each place.

    The darker the fewer.

    In metres, north up; the numbers are per cent. Units are triangles that point where
    they look. A place where all runs are avoided is a small white square without a
    number.
    """
    if places is None:
        places = find_places(setting)
    axes = new_axes(width_in, width_in + (0.55 if width_in >= WIDTH_IN else 0.3))
    draw_scene(axes, setting.scene)
    outline = setting.scene.outline_m
    middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
    points = np.array([place.position_m for place in places])
    reach_m = float(np.abs(points - middle).max()) + _BORDER_M
    if width_in >= WIDTH_IN:
        size = 15.0
    else:
        size = 12.0
    for place in places:
        _draw_place(
            axes, place, place.share_avoided(is_avoided, setting.axis.weight), size
        )
    for unit in layout.units:
        pointing = (3, 0, unit.pose.yaw_deg - 90.0)
        axes.plot(
            *unit.pose.position_m[:2],
            marker=pointing,
            zorder=9,
            gid="unit",
            **_UNIT_STYLE,
        )
    show_square(axes, middle, max(reach_m, _MIN_HALF_SIZE_M))
    axes.set_xlabel(tr("east (m)"), fontsize=8)
    axes.set_ylabel(tr("north (m)"), fontsize=8)
    axes.tick_params(labelsize=7)
    shades = ScalarMappable(Normalize(0.0, 100.0), SHADES)
    below: Style = {
        "orientation": "horizontal",
        "fraction": 0.04,
        "pad": 0.02,
        "aspect": 45,
    }
    bar = root_figure(axes).colorbar(shades, ax=axes, **below)
    bar.set_label(tr("runs avoided there (%)"), fontsize=8)
    bar.ax.tick_params(labelsize=7)
    return axes


def _draw_place(axes: Axes, place: ImpactPlace, share: float, size: float) -> None:
    """Draw a mark with its number; `size` in points."""
    # Runs that do not count.
    if not np.isfinite(share):
        return
    mark: Style = {
        "markeredgecolor": "black",
        "markeredgewidth": 0.7,
        "linestyle": "none",
    }
    mark |= {"markerfacecolor": SHADES(share), "gid": "place"}
    # Small circles are sites.
    if share > 1.0 - 1.0e-9:
        axes.plot(
            *place.position_m, marker="s", markersize=0.27 * size, zorder=7.0, **mark
        )
        return
    # The most dangerous.
    on_top = 8.0 - 0.5 * share
    axes.plot(*place.position_m, marker="o", markersize=size, zorder=on_top, **mark)
    # What is not quite none is never shown as it.
    if share < 1.0e-9:
        shown = 0
    else:
        shown = min(max(round(100.0 * share), 1), 99)
    if share < _DARK_BELOW:
        colour = "white"
    else:
        colour = "black"
    letters: Style = {"ha": "center", "va": "center_baseline", "fontsize": 0.5 * size}
    east_m, north_m = place.position_m
    axes.text(
        east_m, north_m, f"{shown}", color=colour, zorder=on_top, gid="share", **letters
    )
