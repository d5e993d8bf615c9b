"""Everything that the template of the report's interactive part needs."""

import base64
import gzip
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from geometry.arrays import IntArray
from geometry.errors import InputError, Unquoted
from geometry.scene import Scene
from placement.evaluation import Evaluation
from placement.layout import Layout
from placement.setting import Setting

from ...figures.views import GroundViews
from ...results.tables import margin_s
from .records import (
    is_playable,
    party_records,
    plan_record,
    run_record,
    to_script_json,
    unit_records,
    view_paths,
)
from .view import view_record

# ---------- which runs are worth watching


SHOWN_ABOVE = "shown above"
LEAST_TIME = "least time to spare"
NOT_AVOIDED = "not avoided"
ONE_PER_CASE = "one of each case"
ALL_OTHERS = "all others"


def choose_runs(
    evaluation: Evaluation, *, first_runs: Sequence[str] = (), max_runs: int = 24
) -> list[tuple[int, str]]:
    """Runs for the player, and why each is there.

    Pairs of the index of a run, and one of ``SHOWN_ABOVE``, ``LEAST_TIME``, ``NOT_AVOIDED`` and
    ``ONE_PER_CASE``, in this order. Each of the last three gets a third of what is left, or more
    where the others do not need theirs. `first_runs` are ids of runs that come first; unknown ones
    are left out. Raises InputError if `max_runs` is below 1.
    """
    if max_runs < 1:
        raise InputError("max_runs", max_runs, "at least 1")
    axis = evaluation.axis
    index_of = {run_id: index for index, run_id in enumerate(axis.run_ids)}
    chosen = {
        index_of[run_id]: SHOWN_ABOVE for run_id in dict.fromkeys(first_runs) if run_id in index_of
    }
    chosen = dict([*chosen.items()][:max_runs])
    margin = margin_s(evaluation.rsu_all, axis)
    is_avoided = evaluation.rsu_all.is_avoided
    order: IntArray = np.argsort(margin, kind="stable")
    order = order[np.argsort(axis.weight[order] <= 0.0, kind="stable")]  # without weight: last
    missed = _cases_in_turn(order[~is_avoided[order]][::-1], axis.cases)
    groups = {
        LEAST_TIME: [int(index) for index in order[is_avoided[order]]],
        NOT_AVOIDED: missed,
        ONE_PER_CASE: _first_of_each(order, [*zip(axis.cases, axis.weathers, strict=True)]),
    }
    share = -(-(max_runs - len(chosen)) // len(groups))
    for quota in (share, max_runs):
        for group, members in groups.items():
            free = [index for index in members if index not in chosen]
            taken = sum(name == group for name in chosen.values())
            for index in free[: min(quota - taken, max_runs - len(chosen))]:
                chosen[index] = group
    names = [SHOWN_ABOVE, *groups]
    return sorted(chosen.items(), key=lambda item: names.index(item[1]))


def _first_of_each(order: IntArray, kinds: Sequence[object]) -> list[int]:
    """The first run of each kind, kinds as they first appear among all runs."""
    first: dict[object, int] = {}
    for index in order:
        first.setdefault(kinds[index], int(index))
    return [first[kind] for kind in dict.fromkeys(kinds)]


def _cases_in_turn(order: IntArray, cases: Sequence[str]) -> list[int]:
    """Runs so that one of each case comes before the second of any."""
    seen: dict[str, int] = {}
    ranks = []
    for index in order:
        seen[cases[index]] = seen.get(cases[index], 0) + 1
        ranks.append(seen[cases[index]])
    return [int(index) for index in order[np.argsort(ranks, kind="stable")]]


# ---------- what the template needs


_PLOTLY_PACKAGE = "plotly"
_MAX_BYTES = 1_500_000  # of records: some four hundred runs of a dozen units


def interactive_part(
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    max_runs: int = 24,
    first_runs: Sequence[str] = (),
) -> dict[str, Any] | None:
    """Values for ``templates/interactive.html.j2``.

    The first evaluation is the subject. Of the others, all units together are a row of the heatmap,
    and sensors are in the 3-D view. At most `max_runs` runs stand out in the list; all others
    follow as long as they fit.

    "n_runs", "player_json", "view_json", "note" (what the 3-D view leaves out), "plotly_gzip"
    (empty where the package plotly is missing: no 3-D view). None if no run has the frames that
    were evaluated. Raises InputError if there is no evaluation, or `max_runs` is not positive.
    """
    if not evaluations:
        raise InputError("evaluations", Unquoted("none"), "at least one")
    subject = next(iter(evaluations.values()))
    by_id = {run.id: run for run in setting.runs}
    chosen = choose_runs(subject, first_runs=first_runs, max_runs=max_runs)
    outstanding = {index for index, _ in chosen}
    others = [index for index in range(subject.axis.n_runs) if index not in outstanding]
    records: list[dict[str, Any]] = []
    n_bytes = 0
    for index, group in [*chosen, *((index, ALL_OTHERS) for index in others)]:
        run = by_id.get(subject.axis.run_ids[index])
        if run is None or not all(is_playable(run, item) for item in evaluations.values()):
            continue
        if group == ALL_OTHERS and n_bytes > _MAX_BYTES:
            break
        records.append(run_record(run, evaluations, group=group))
        n_bytes += len(to_script_json(records[-1]))
    if not records:
        return None
    units_m = np.array([unit.pose.position_m[:2] for unit in subject.layout.units])
    player = {
        "plan": plan_record(setting.scene, units_m),
        "units": [
            record | {"view": view}
            for record, view in zip(
                unit_records(subject.layout, setting.scene),
                view_paths(subject.layout.units, GroundViews(setting)),
                strict=True,
            )
        ],
        "parties": party_records(evaluations),
        "runs": records,
    }
    other_layouts = [item.layout for item in [*evaluations.values()][1:]]
    return {
        "n_runs": len(records),
        "n_all": subject.axis.n_runs,
        "player_json": to_script_json(player),
        **view_part(setting.scene, subject.layout, other_layouts),
    }


def view_part(scene: Scene, layout: Layout | None, others: Sequence[Layout] = ()) -> dict[str, str]:
    """Values for ``templates/view_3d.html.j2``, which stands alone, too; nothing may hang."""
    view = view_record(scene, layout, others)
    return {
        "view_json": to_script_json(view),
        "note": view["note"],
        "plotly_gzip": packed_plotly(),
    }


@cache
def packed_plotly() -> str:
    """plotly.js as the page holds it, in base64 of gzip: a third of its size; may be empty."""
    source = plotly_script()
    # No time stamp, so that equal reports are equal files.
    return base64.b64encode(gzip.compress(source.encode(), mtime=0)).decode() if source else ""


def plotly_script() -> str:
    """Source of plotly.js as the package plotly brings it; empty where it is not installed."""
    try:
        from plotly.offline import get_plotlyjs
    except ModuleNotFoundError as error:
        if error.name != _PLOTLY_PACKAGE:
            raise
        return ""
    return str(get_plotlyjs())
