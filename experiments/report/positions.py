"""Where it is still dangerous: the junction from above, and shares by position along the arms."""

from collections.abc import Mapping

from geometry.arrays import BoolArray
from placement.evaluation import Evaluation
from placement.setting import Setting
from scenarios.runs import FrameAxis
from scenarios.weights import weight_share

from ..figures.axes import NARROW_IN, WIDTH_IN
from ..figures.dangers import find_places, plot_dangers
from ..parts.section import Block, Box, Picture, Section, Table, build_picture
from ..results.dangers import avoided_runs
from ..results.numbers import percent
from ..results.tables import groups_by_direction, groups_by_position
from .answer import is_weighted, position_words


def positions_section(setting: Setting, shown: Mapping[str, Evaluation], *, fusion: str) -> Section:
    """Which places stay dangerous; layouts by display name.

    The first one, which was chosen with this fusion, is drawn, and so is the last one: that is what
    it is compared with.
    """
    names = list(dict.fromkeys([next(iter(shown)), [*shown][-1]]))
    avoided = {
        name: avoided_runs(shown[name], fusion if order == 0 else "any")
        for order, name in enumerate(names)
    }
    pictures = danger_pictures(setting, {name: shown[name] for name in names}, avoided)
    by_weight = ", by weight," if is_weighted(setting.axis) else ""
    note = (
        "Every mark is a place where runs end in an impact if nobody brakes: impacts at most 6 m "
        f"apart are one place. The number is the share of its runs{by_weight} that the units "
        "avoid, in per cent; the darker, the more is left. At small white squares all are avoided. "
        "Triangles are units, rings are sites that could carry some."
    )
    blocks: list[Block] = [note, Box("beside" if len(pictures) > 1 else "", pictures)]
    if len(groups_by_position(setting.axis)) > 1:
        blocks += [position_table(name, avoided[name], setting.axis) for name in names]
    return Section("dangers", "Where it is still dangerous", blocks)


def danger_pictures(
    setting: Setting, shown: Mapping[str, Evaluation], avoided: Mapping[str, BoolArray]
) -> list[Picture]:
    """The junction from above with each of some layouts, narrower where there are several."""
    places = find_places(setting)
    pictures = []
    for name, item in shown.items():
        drawn = {
            width_in: plot_dangers(
                setting, item.layout, avoided[name], places=places, width_in=width_in
            )
            for width_in in ((NARROW_IN,) if len(shown) > 1 else (WIDTH_IN, NARROW_IN))
        }
        shares = [place.share_avoided(avoided[name], setting.axis.weight) for place in places]
        n_left = sum(share < 1.0 for share in shares)
        pictures.append(
            build_picture(
                drawn[max(drawn)],
                narrow=drawn[NARROW_IN] if len(drawn) > 1 else None,
                title=f"Where it is still dangerous with {name}",
                caption=f"Places with runs that are not avoided: {n_left} of {len(places)}.",
                alt=f"The junction from above: {len(places)} places, {n_left} of them with runs "
                "that are not avoided. The tables below have the shares by position.",
            )
        )
    return pictures


def position_table(name: str, is_avoided: BoolArray, axis: FrameAxis) -> Table:
    """Share of the runs that a layout avoids, by position along the arms and approach of the car.

    A row for each position as the car passes them, with how many of its runs are avoided.
    """
    approaches = groups_by_direction(axis)
    return Table(
        caption=f"Where along the arms {name} avoids how much",
        columns=["where", "APR", "runs avoided", *(f"from the {name}" for name, _ in approaches)],
        rows=[
            [
                position_words(position),
                _share(is_avoided, axis, at),
                f"{int((is_avoided & at).sum())} of {int(at.sum())}",
                *(_share(is_avoided, axis, at & of_approach) for _, of_approach in approaches),
            ]
            for position, at in groups_by_position(axis)
        ],
        numeric=range(1, 3 + len(approaches)),
    )


def _share(is_avoided: BoolArray, axis: FrameAxis, mask: BoolArray) -> str:
    """Share of some runs, by weight; a dash where there are none."""
    return percent(weight_share(is_avoided, axis.weight * mask))
