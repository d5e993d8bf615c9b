"""How much each run counts: equally, per case, or as a scheme of a registry says.

Schemes weigh by accidents, statistics, points, or a CSV file.
"""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray
from geometry.errors import InputError, Unquoted
from geometry.registry import load_entry

from .positions import is_study_set
from .runs import Refusal, Run

# ---------- weights by a word
RATING = "euroncap-rating-2026"
CRASH_TYPES = "fhwa-crash-types"
UNFALLATLAS = "unfallatlas"
STATS19 = "stats19"
WEIGHT_WORDS = ("run", "case", CRASH_TYPES, RATING)
"""Of :func:`weigh`, but for files."""
FORMATS = (UNFALLATLAS, STATS19)
"""Formats of accidents: words before a colon and a file."""
_TABLE = "csv"
SCHEMES = {
    RATING: "scenarios.weight_tables:RatingWeights",
    CRASH_TYPES: "scenarios.weight_tables:CrashTypeWeights",
    UNFALLATLAS: "scenarios.accidents:AccidentWeights",
    STATS19: "scenarios.accidents:AccidentWeights",
    _TABLE: "scenarios.weight_tables:TableWeights",
}
"""Registry of what runs are weighed by, other than equally.

Each entry takes the word of a user and makes a :class:`WeightScheme`.
"""


class WeightScheme(Protocol):
    """What weighs runs by the word of a user."""

    def check(self) -> None:
        """Check what can be checked without runs.

        Raises InputError: a file cannot be used. MissingExtraError: what it needs is
        not installed.
        """

    def files(self) -> tuple[Path, ...]:
        """Files that the weights are read from."""

    def weigh(
        self,
        runs: Sequence[Run],
        *,
        near: tuple[float, float] | None,
        within_m: float | None,
    ) -> FloatArray:
        """Weights of runs (n_runs,), which sum to 1; see :func:`weigh`."""


def _scheme(how: str) -> WeightScheme:
    """What a word stands for."""
    if how in (RATING, CRASH_TYPES):
        key = how
    elif needs_place(how):
        key = how.partition(":")[0]
    else:
        key = _TABLE
    make: Callable[[str], WeightScheme] = load_entry(SCHEMES[key])
    return make(how)


def needs_place(how: str) -> bool:
    """True for words that name accidents, which have places on earth."""
    form, colon, _ = how.partition(":")
    return bool(colon) and form in FORMATS


def default_weights(cases: str) -> str:
    """The word for :func:`weigh` where the user gives none, by the words for the cases.

    The runs of the study's set count the same, as in the study; else all cases do.
    """
    if is_study_set(cases):
        return "run"
    return "case"


def weigh(
    runs: Sequence[Run],
    how: str,
    *,
    refused: Sequence[Refusal] = (),
    near: tuple[float, float] | None = None,
    within_m: float | None = None,
) -> FloatArray:
    """Weights of runs, at least one, by the word of a user, (n_runs,); they sum to 1.

    `how`: "run": every run the same, as in the study; "case": every case the same, see
    :func:`scenarios.weights.weight_per_case`; "fhwa-crash-types": by accident
    statistics, see :func:`scenarios.weight_tables.weight_by_crash_types`;
    "euroncap-rating-2026": by its points, see
    :func:`scenarios.weight_tables.weight_by_rating`; "unfallatlas:FILE",
    "stats19:FILE": by the accidents around a place, see
    :func:`scenarios.accidents.weight_by_accidents`; else a CSV file, see
    :func:`scenarios.weight_tables.weight_from_csv`. `refused`: what was asked for next
    to the runs, and could not be laid: "case" alone looks at it. `near`: latitude and
    longitude of the place [deg]. `within_m`: how far from there accidents
    count [m]; default: that of ``data/accidents.toml``.

    Raises
    ------
    InputError
        The word is unknown and no file, the weights do not fit the runs, or
        nobody knows the place.
    MissingExtraError
        What the word needs is not installed.
    """
    if how == "run":
        return weight_per_run(runs)
    if how == "case":
        return weight_per_case(runs, refused=refused)
    return _scheme(how).weigh(runs, near=near, within_m=within_m)


def check_weights(how: str) -> None:
    """Check the word of a user as far as it goes without runs.

    Raises
    ------
    InputError
        As :func:`weigh`.
    """
    if how not in ("run", "case"):
        _scheme(how).check()


def weight_files(how: str) -> tuple[Path, ...]:
    """Files that the weights by a word of a user are read from, see :func:`weigh`."""
    if how in ("", "run", "case"):
        return ()
    return _scheme(how).files()


def weight_by_function(
    runs: Sequence[Run], function: Callable[[Run], float]
) -> FloatArray:
    """Weights by a user's own function of a run; they sum to 1.

    Raises
    ------
    InputError
        It gives anything but finite numbers >= 0, or 0 for all runs.
    """
    weight = np.array([function(run) for run in runs], dtype=np.float64)
    wrong = np.flatnonzero(~(np.isfinite(weight) & (weight >= 0.0)))
    if len(wrong):
        run = runs[int(wrong[0])]
        raise InputError(
            f"weights: {run.id}", float(weight[wrong[0]]), "a finite number >= 0"
        )
    if not weight.any():
        raise InputError(
            "weights", Unquoted("0 for all runs"), "one weight more than 0"
        )
    return shares_of(weight)


def weight_per_run(runs: Sequence[Run]) -> FloatArray:
    """Equal weight for every run, as in the study."""
    return np.full(len(runs), 1.0 / len(runs))


def weight_per_case(
    runs: Sequence[Run], *, refused: Sequence[Refusal] = ()
) -> FloatArray:
    """Equal weight for every case, as far as the junction carries it.

    A case that is driven in full has as much weight as any other, shared equally by its
    approaches, in these by positions, in these by runs - speeds and weathers: position
    0, where every speed is driven, weighs no more than another one. Runs that have no
    room, and approaches that do not carry the case at all, take their shares away with
    them: the case weighs less, and the few runs that remain of it no more than they
    would among all others. Otherwise the only turn that a map allows would weigh as
    much as a hundred crossings. Positions that the mapped lanes do not reach have no
    share. `runs`: at least one. `refused`: what was asked for next to them, and could
    not be laid. Returns `weight` (n_runs,): sums to 1.
    """
    # Shares go from the case to its approaches, their positions, and the runs there.
    keys = [(run.case.name, run.approach, run.position) for run in runs]
    n_weathers = len({run.weather for run in runs})
    n_runs = Counter(keys)
    for one in refused:
        if one.is_possible:
            key = (one.case.name, one.approach, one.position)
            n_runs[key] += len(one.speeds_kmh) * n_weathers
    n_positions = Counter(key[:2] for key in n_runs)
    asked = {(one.case.name, one.approach) for one in refused} | set(n_positions)
    n_approaches = Counter(case for case, _ in asked)
    alike = [n_approaches[key[0]] * n_positions[key[:2]] * n_runs[key] for key in keys]
    return shares_of(1.0 / np.array(alike))


def weight_share(mask: ArrayLike, weight: ArrayLike) -> float:
    """Weight of the runs in a mask / weight of all; NaN if there is no weight at all.

    It is exactly 1 where all runs with weight count.

    >>> weight_share([True] * 49, [1.0 / 49.0] * 49)
    1.0
    """
    weights = np.asarray(weight, dtype=np.float64)
    total = math.fsum(weights.tolist())
    counted = math.fsum(weights[np.asarray(mask, dtype=bool)].tolist())
    if total > 0.0:
        return counted / total
    return math.nan


def shares_of(weight: FloatArray) -> FloatArray:
    """Weights that sum to 1."""
    return np.asarray(weight / weight.sum())
