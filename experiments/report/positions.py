"""Where it is still dangerous: the junction from above, and shares by position along the arms."""

from collections.abc import Mapping

from geometry.arrays import BoolArray
from placement.evaluation import Evaluation
from placement.setting import Setting
from scenarios.exposure import weight_share
from scenarios.runs import FrameAxis

from ..figures.axes import NARROW_IN, WIDTH_IN
from ..figures.dangers import find_places, plot_dangers
from ..results.dangers import avoided_runs
from ..results.numbers import NOTHING, percent
from ..results.tables import groups_by_direction, groups_by_position
from .answer import position_words
from .section import Block, Box, Picture, Section, Table, build_picture


def positions_section(
    setting: Setting, evaluations: Mapping[str, Evaluation], *, fusion: str
) -> Section:
    """Which places stay dangerous; layouts by display name.

    The first one, which was chosen with this fusion, is drawn, and so is the last one: that is what
    it is compared with.
    """
    avoided = {
        name: avoided_runs(item, fusion if order == 0 else "any")
        for order, (name, item) in enumerate(evaluations.items())
    }
    names = list(avoided)
    shown = {name: evaluations[name] for name in (names[0], names[-1])}
    pictures = danger_pictures(setting, shown, avoided)
    note = (
        "Every mark is a place where runs end in an impact if nobody brakes: impacts at most 6 m "
        "apart are one place. The number is the share of its runs, by weight, that the units "
        "avoid, in per cent; the darker, the more is left."
    )
    blocks: list[Block] = [note, Box("beside" if len(pictures) > 1 else "", pictures)]
    axis = setting.axis
    if len(groups_by_position(axis)) > 1:
        blocks += [position_table(avoided, axis), approach_table(names[0], avoided[names[0]], axis)]
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
                caption=f"Of {len(places)} places, {n_left} have runs that are not avoided.",
                alt=f"The junction from above: {len(places)} places, {n_left} of them with runs "
                "that are not avoided. The tables below have the shares by position.",
            )
        )
    return pictures


def position_table(avoided: Mapping[str, BoolArray], axis: FrameAxis) -> Table:
    """Share of the runs that each layout avoids, by position along the arms."""
    return Table(
        caption="Share of the runs that are avoided, by position along the arms",
        columns=["where", "runs", *avoided],
        rows=[
            [
                position_words(position),
                str(int(mask.sum())),
                *(_share(is_avoided, axis, mask) for is_avoided in avoided.values()),
            ]
            for position, mask in groups_by_position(axis)
        ],
        numeric=range(1, 2 + len(avoided)),
    )


def approach_table(name: str, is_avoided: BoolArray, axis: FrameAxis) -> Table:
    """Share of the runs that a layout avoids, by approach of the car and position."""
    positions = groups_by_position(axis)
    return Table(
        caption=f"Share of the runs that {name} avoids, by approach and position",
        columns=["the car comes from the", *(f"at {position} m" for position, _ in positions)],
        rows=[
            [
                approach,
                *(_share(is_avoided, axis, of_approach & mask) for _, mask in positions),
            ]
            for approach, of_approach in groups_by_direction(axis)
        ],
        numeric=range(1, 1 + len(positions)),
    )


def _share(is_avoided: BoolArray, axis: FrameAxis, mask: BoolArray) -> str:
    """Share by weight, and how many of how many runs."""
    if not mask.any():
        return NOTHING
    share = weight_share(is_avoided, axis.weight * mask)
    return f"{percent(share)} ({int((is_avoided & mask).sum())} of {int(mask.sum())})"
