"""Where it is still dangerous.

Runs that nobody avoids, by case and place, and their map.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np

from geometry.arrays import BoolArray
from geometry.registry import load_entry
from placement.evaluation import Evaluation
from placement.layout import Layout
from placement.setting import Setting
from scenarios.positions import AT_ZERO, read_position
from scenarios.runs import FrameAxis
from scenarios.weights import weight_share

from ..figures.axes import NARROW_IN
from ..language import tr, trn
from ..results.cached import cached_part
from ..results.numbers import joined, percent
from ..results.record import Record, says
from ..results.tables import RunGroup, groups_by
from .accidents import is_weighted
from .section import Block, Box, Pictures, Section, Table, build_picture

_MAX_GROUPS = 3


class DangerGroup(Record, frozen=True, kw_only=True):
    """Some runs that are alike, and how many of them are not avoided."""

    name: Annotated[str, says("Of the case, or of the position along the arms.")]
    title: Annotated[str, says("What happens in the case; empty for a position.")] = ""
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


def build_dangers(
    is_avoided: BoolArray, axis: FrameAxis, *, titles: Mapping[str, str] | None = None
) -> Dangers:
    """Runs that are not avoided, counted by case and position.

    Weights do not matter. `titles` say by name what happens in cases.
    """
    positions = groups_by(axis, "position")
    return Dangers(
        not_avoided=int((~is_avoided).sum()),
        by_case=_groups(groups_by(axis, "case"), is_avoided, titles or {}),
        by_position=_groups(positions, is_avoided, {}) if len(positions) > 1 else (),
    )


def _groups(
    groups: Sequence[RunGroup], is_avoided: BoolArray, titles: Mapping[str, str]
) -> tuple[DangerGroup, ...]:
    records = [
        DangerGroup(
            name=name,
            title=titles.get(name, ""),
            runs=int(mask.sum()),
            not_avoided=int((mask & ~is_avoided).sum()),
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
    where = _most_left(dangers.by_case, _case_words, others)
    if dangers.by_position:
        places = _most_left(
            dangers.by_position,
            lambda group: position_words(group.name),
            tr("elsewhere"),
        )
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


def _case_words(group: DangerGroup) -> str:
    """A case in words, for who knows no codes."""
    if not group.title:
        return tr("in {case}", case=group.name)
    return tr("in {case} ({title})", case=group.name, title=group.title)


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
    groups: Sequence[DangerGroup], words_of: Callable[[DangerGroup], str], others: str
) -> str:
    """The groups with the largest share that is left.

    Then how many runs are left in all others.
    """
    left = [group for group in groups if group.not_avoided]
    words = [
        tr(
            "{where} {n} of {all}",
            where=words_of(group),
            n=group.not_avoided,
            all=group.runs,
        )
        for group in left[:_MAX_GROUPS]
    ]
    n_others = sum(group.not_avoided for group in left[_MAX_GROUPS:])
    return joined([*words, *([f"{others} {n_others}"] if n_others else [])])


def section(
    setting: Setting,
    shown: Mapping[str, Evaluation],
    *,
    fusion: str,
    cache_folder: Path | None = None,
) -> Section:
    """Which places stay dangerous; layouts by display name.

    Drawn are the first one, which was chosen with this fusion, and the last one.
    """
    names = dict.fromkeys([next(iter(shown)), [*shown][-1]])
    avoided = {
        name: avoided_runs(shown[name], "any" if order else fusion)
        for order, name in enumerate(names)
    }
    layouts = {name: shown[name].layout for name in names}
    pictures = cached_part(
        cache_folder,
        "dangers",
        lambda: _draw(setting, layouts, avoided),
        kind=Pictures,
        made_from=(setting.scene, setting.runs, setting.axis, layouts, avoided),
    )
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


def _draw(
    setting: Setting, layouts: Mapping[str, Layout], avoided: Mapping[str, BoolArray]
) -> Pictures:
    """A picture of each layout, by display name, with the runs that it avoids."""
    # By name: what draws is loaded only where the pictures are not cached.
    places = load_entry("experiments.figures.dangers:find_places")(setting)
    plot = load_entry("experiments.figures.dangers:plot_dangers")
    pictures = []
    for name, mask in avoided.items():
        drawn = plot(setting, layouts[name], mask, places=places, width_in=NARROW_IN)
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
    return tuple(pictures)


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
