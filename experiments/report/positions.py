"""Where it is still dangerous: the junction from above, and shares by position along the arms."""

from collections.abc import Mapping

from placement.evaluation import Evaluation
from placement.setting import Setting
from scenarios.exposure import weight_share

from ..figures.axes import NARROW_IN, WIDTH_IN
from ..figures.dangers import find_places, plot_dangers
from ..results.dangers import avoided_runs
from ..results.numbers import percent
from ..results.tables import groups_by_direction, groups_by_position
from .answer import position_words
from .section import Block, Box, Picture, Section, Table, build_picture


def positions_section(
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    drawn: Mapping[str, Evaluation],
    fusion: str,
) -> Section:
    """Which places stay dangerous, for layouts by display name; those drawn from above, the rest.

    The first evaluation is the subject, chosen with this fusion.
    """
    places = find_places(setting)
    n_left = sum(
        place.share_avoided(avoided_runs(next(iter(evaluations.values())), fusion),
        setting.axis.weight) < 1.0
        for place in places
    )
    blocks: list[Block] = []
    return Section("dangers", "Where it is still dangerous", blocks)
