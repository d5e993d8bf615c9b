"""Euro NCAP's points of 2026 as weights of runs: needs the extra `rating`."""

from collections.abc import Sequence
from functools import cache
from importlib.resources import files

import numpy as np

from geometry.arrays import FloatArray
from geometry.errors import InputError, MissingExtraError, Unquoted
from geometry.toml_files import load_toml, take_list, take_text

from .runs import Run

RATING = "euroncap-rating-2026"


def weight_by_rating(runs: Sequence[Run]) -> FloatArray:
    """Weights by the points that Euro NCAP gives the cases in 2026.

    Parameters
    ----------
    runs : sequence of Run
        At least one.

    Returns
    -------
    weight : (n_runs,) float
        The points that a score can earn at most (standard and extended range, robustness) are
        shared equally by the runs that belong to it; those of scores without runs are nobody's.
        Runs without a score, such as all in the rain, weigh nothing. Sums to 1.

    Raises
    ------
    MissingExtraError
        The package is not installed.
    InputError
        No run has points.
    """
    points = load_points()
    weight = np.zeros(len(runs))
    for (cases, weather), score in points.items():
        members = [
            index
            for index, run in enumerate(runs)
            if run.weather == weather and _family(run.case.name) in cases
        ]
        weight[members] = score / max(len(members), 1)
    if not weight.any():
        driven = ", ".join(dict.fromkeys(f"{run.case.name} ({run.weather})" for run in runs))
        raise InputError("--weights", RATING, f"a run that has points in 2026; driven: {driven}")
    shares: FloatArray = weight / weight.sum()
    return shares


@cache
def load_points() -> dict[tuple[tuple[str, ...], str], float]:
    """Points by cases (what our names begin with) and weather, from the installed package.

    Raises
    ------
    MissingExtraError
        The package is not installed.
    InputError
        The package does not know a score any more.
    """
    try:
        from euroncap_rating_2026.crash_avoidance.data_model import TOTAL_SCORES
    except ModuleNotFoundError:
        raise MissingExtraError(
            f"--weights {RATING} needs that package: pip install place-rsus[rating]"
        ) from None
    table = load_toml(files(__package__) / "data" / "rating_2026.toml")
    points = {}
    for index, entry in enumerate(take_list(table, "scores", "rating_2026.toml")):
        where = f"rating_2026.toml: scores[{index}]"
        name = take_text(entry, "name", where)
        if name not in TOTAL_SCORES:
            raise InputError(
                where, Unquoted(f"{name!r}, unknown to the installed {RATING}"), "a score of it"
            )
        key = (tuple(take_list(entry, "cases", where)), take_text(entry, "weather", where))
        points[key] = float(sum(part or 0.0 for part in TOTAL_SCORES[name].values()))
    return points


def _family(case_name: str) -> str:
    return case_name.rpartition("-")[0] or case_name
