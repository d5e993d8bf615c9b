"""What a run counts that is not avoided.

It counts nothing, or by what is left of the VUT's speed at contact.

A score gives a run levels: closing speeds at contact, the slower the more it counts. Of
each level there is a last onset of braking (:func:`scenarios.aeb.last_onsets_s`), so
that to an optimiser it is a run of its own with a later deadline; what it weighs is
what it adds to the next worse level. ``data/scores.toml`` has Euro NCAP's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, Struct

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.errors import InputError
from geometry.tables import Text, read_table
from geometry.text_formats import load_data

from .aeb import AebRule, find_contacts, last_onsets_s
from .paths import MPS_PER_KMH
from .runs import Run

AVOIDED = "avoided"
RATING_2026 = "rating-2026"
SCORES = (AVOIDED, RATING_2026)

# Speeds that differ by less are equal: they carry rounding noise.
_SAME_KMH = 1.0e-6
_Share = Annotated[float, Meta(gt=0.0, le=1.0)]
_Speed = Annotated[float, Meta(ge=0.0)]


class Bands(Struct, frozen=True, kw_only=True):
    """Limits and what counts within them, for VUTs from a speed on."""

    vut_from_kmh: _Speed
    limits: tuple[tuple[_Speed, _Share], ...]


class Criterion(Struct, frozen=True, kw_only=True):
    """How some cases are judged.

    Attributes
    ----------
    criterion : str
        What counts: "avoidance", "mitigation", or both.
    measure : {"below", "lost"}
        The speed at contact, or what braking has taken of it.
    cases : tuple of str
        What names of cases begin with that it judges.
    bands : tuple of Bands
        What counts, by the VUT's speed.
    """

    criterion: Text
    measure: Literal["below", "lost"]
    cases: tuple[Text, ...]
    bands: tuple[Bands, ...]


@cache
def load_criteria(score: str) -> tuple[Criterion, ...]:
    """Criteria of a score from ``data/scores.toml``.

    There are none of "avoided".

    Raises
    ------
    InputError
        The score is unknown.
    """
    if score == AVOIDED:
        return ()
    tables = load_data(__package__, "scores.toml")
    if score not in tables:
        raise InputError("score", score, "one of " + ", ".join(SCORES))
    return read_table(tables[score], tuple[Criterion, ...], f"scores.toml: {score}")


def bands_kmh(
    score: str,
    case_name: str,
    vut_speed_kmh: float,
    *,
    unbraked_kmh: float | None = None,
) -> tuple[tuple[float, float], ...]:
    """Closing speeds at contact, and what counts below each.

    The best comes first: ((0, 1.0), ...).

    The first one, below which nothing can be, stands for runs that are avoided.
    `unbraked_kmh` is the closing speed of the impact without braking, by default the
    VUT's speed: where what braking has taken counts, it is taken from that.

    >>> bands_kmh("rating-2026", "CPNA-25", 45.0)
    ((0.0, 1.0), (10.0, 0.5), (20.0, 0.25))
    """
    # Avoided runs count in full.
    found = [(0.0, 1.0)]
    words = case_name.split("-")
    names = ["-".join(words[:n]) for n in range(len(words), 0, -1)]
    criteria = load_criteria(score)
    # The criterion that names the case, or the most of what its name begins with.
    for criterion in [one for name in names for one in criteria if name in one.cases][
        :1
    ]:
        reached = [one for one in criterion.bands if one.vut_from_kmh <= vut_speed_kmh]
        bands = max(reached, key=lambda one: one.vut_from_kmh)
        for limit_kmh, share in bands.limits:
            if unbraked_kmh is None:
                closing_kmh = vut_speed_kmh
            else:
                closing_kmh = unbraked_kmh
            if criterion.measure == "lost":
                below_kmh = closing_kmh - limit_kmh
            else:
                below_kmh = limit_kmh
            if below_kmh > 0.0:
                found.append((below_kmh, share))
    return tuple(found)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Levels:
    """Levels of runs, run by run, the best level of each first.

    Attributes
    ----------
    score : str
        Name of the score.
    run_index : (n_levels,) int
        Run of each level, ascending; each run has one at least.
    below_kmh : (n_levels,) float
        Reached by closing speeds at contact below this; 0: by runs that are
        avoided. [km/h]
    gain : (n_levels,) float
        What reaching it adds to the next worse level of its run, a share of the
        run's weight; those of a run sum to 1.
    deadline_s : (n_levels,) float
        Last onset of braking that reaches it, and so does every earlier one; of
        avoided runs the last brake time. [s]
    """

    score: str
    run_index: IntArray
    below_kmh: FloatArray
    gain: FloatArray
    deadline_s: FloatArray

    def __post_init__(self) -> None:
        for name in ("run_index", "below_kmh", "gain", "deadline_s"):
            object.__setattr__(self, name, freeze(np.array(getattr(self, name))))

    @property
    def first(self) -> IntArray:
        """The first level of each run, (n_runs,)."""
        return np.asarray(np.flatnonzero(np.diff(self.run_index, prepend=-1)))

    def of_speeds(self, closing_kmh: FloatArray, is_avoided: BoolArray) -> FloatArray:
        """What runs count by their closing speeds at contact.

        Arrays are (..., n_runs), and so is the result.
        """
        run = self.run_index
        slower = closing_kmh[..., run] < self.below_kmh - _SAME_KMH
        return self._of_levels(is_avoided[..., run] | slower)

    def of_onsets(self, onset_s: FloatArray, tolerance_s: float) -> FloatArray:
        """What runs count by the onsets of braking, in seconds.

        An onset is infinite where there is none.
        """
        return self._of_levels(
            onset_s[..., self.run_index] <= self.deadline_s + tolerance_s
        )

    def _of_levels(self, is_reached: BoolArray) -> FloatArray:
        """Sum of the gains of levels that are reached, by run."""
        gains = np.where(is_reached, self.gain, 0.0)
        return np.add.reduceat(gains, self.first, axis=-1)


def build_levels(runs: Sequence[Run], score: str, rule: AebRule) -> Levels | None:
    """Levels of runs by a score; None for "avoided", where each run has one alone.

    A speed that the impact without braking already stays below is no level: nobody
    has to do anything for it.

    Raises
    ------
    InputError
        There is no such score.
    """
    if not load_criteria(score):
        return None
    known: dict[tuple[int, tuple[float, ...]], FloatArray] = {}
    rows: list[tuple[int, float, float, float]] = []
    for index, run in enumerate(runs):
        unbraked_kmh = (
            float(find_contacts(run.encounter, 0.0, rule).closing_mps) / MPS_PER_KMH
        )
        bands = bands_kmh(
            score, run.case.name, run.vut_speed_kmh, unbraked_kmh=unbraked_kmh
        )
        limits = tuple(below for below, _ in bands[1:])
        # One and the same in all weathers.
        key = id(run.encounter), limits
        if limits and key not in known:
            below_mps = [limit * MPS_PER_KMH for limit in limits]
            known[key] = last_onsets_s(
                run.encounter,
                rule,
                below_mps=below_mps,
                avoids_until_s=run.last_brake_time_s,
            )
        # One deadline for each level: that of avoiding comes first.
        deadlines = [run.last_brake_time_s, *(known[key].tolist() if limits else [])]
        levels = zip(bands, deadlines, strict=True)
        told = [(*band, at_s) for band, at_s in levels if at_s < 0.0 or band[0] == 0.0]
        shares = [share for _, share, _ in told]
        gains = [one - other for one, other in pairwise([*shares, 0.0])]
        gained = zip(told, gains, strict=True)
        rows += [
            (index, below, gain, at_s)
            for (below, _, at_s), gain in gained
            if gain > 0.0
        ]
    run_index, below_kmh, gain, deadline_s = zip(*rows, strict=True)
    return Levels(
        score=score,
        run_index=np.array(run_index, dtype=np.int64),
        below_kmh=np.array(below_kmh, dtype=np.float64),
        gain=np.array(gain, dtype=np.float64),
        deadline_s=np.array(deadline_s, dtype=np.float64),
    )
