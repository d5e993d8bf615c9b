"""Everything that the template of the report's interactive part needs."""

import base64
import gzip
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from geometry.errors import InputError, Unquoted
from placement.evaluation import Evaluation
from placement.setting import Setting

from .ground_paths import plan_record
from .run_choice import ALL_OTHERS, choose_runs
from .run_records import is_playable, party_records, run_record
from .script_text import to_script_json
from .unit_records import unit_records
from .view import view_record

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

    Parameters
    ----------
    setting : Setting
        Scene and runs.
    evaluations : mapping of str to Evaluation
        By display name; the first one is the subject. Of the others, all units together are a row
        of the heatmap, and sensors are in the 3-D view.
    max_runs : int
        At most so many runs stand out in the list; all others follow as long as they fit.
    first_runs : sequence of str
        Ids of runs that come first, as those whose heatmaps the page shows.

    Returns
    -------
    part : dict or None
        "runs" (their number), "player_json", "view_json", "note" (what the 3-D view leaves out),
        "plotly_gzip" (empty where the package plotly is missing: no 3-D view). None if no run has
        the frames that were evaluated.

    Raises
    ------
    InputError
        There is no evaluation, or `max_runs` is not positive.
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
        "units": unit_records(subject.layout),
        "parties": party_records(evaluations),
        "runs": records,
    }
    other_layouts = [item.layout for item in [*evaluations.values()][1:]]
    view = view_record(setting.scene, subject.layout, other_layouts)
    return {
        "n_runs": len(records),
        "n_all": subject.axis.n_runs,
        "player_json": to_script_json(player),
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
