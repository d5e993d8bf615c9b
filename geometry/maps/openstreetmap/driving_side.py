"""On which side traffic keeps, as far as a map shows it."""

from collections import Counter

import numpy as np
import shapely

from ...arrays import FloatArray
from .elements import Elements, Way
from .lane_counts import is_oneway, runs_backward
from .network import is_for_cars, known_runs

_CLEAR = 0.8  # of all that shows a side
_CARRIAGEWAYS_M = (3.0, 30.0)  # apart


def find_driving_side(elements: Elements, positions_m: FloatArray) -> tuple[bool, str]:
    """Whether traffic keeps left.

    Parameters
    ----------
    elements : Elements
        What the file has.
    positions_m : (n, 2) float
        Of its nodes. [m]

    Returns
    -------
    keeps_left : bool
        From the tag, or from which way round cars drive in roundabouts, or from which side the
        other carriageway of a street lies on; otherwise False.
    how : str
        What showed it; empty: nothing, it is assumed.
    """
    ways = [way for way in elements.ways if is_for_cars(way.tags)]
    tagged = Counter(
        way.tags["driving_side"] for way in ways if way.tags.get("driving_side") in _SIDES
    )
    if tagged:
        return tagged["left"] > tagged["right"], "its tag"
    for votes, how in (
        (_roundabouts(ways, positions_m), "roundabouts"),
        (_carriageways(ways, positions_m), "carriageways"),
    ):
        n_votes = sum(votes.values())
        for keeps_left in (True, False):
            if n_votes and votes[keeps_left] >= _CLEAR * n_votes:
                return keeps_left, how
    return False, ""


_SIDES = ("left", "right")


def _points(way: Way, positions_m: FloatArray) -> list[FloatArray]:
    step = -1 if runs_backward(way.tags) else 1
    return [positions_m[rows[::step]] for rows in known_runs(way.rows, positions_m)]


def _roundabouts(ways: list[Way], positions_m: FloatArray) -> Counter[bool]:
    """Clockwise where traffic keeps left; parts of a ring bend that way too."""
    votes: Counter[bool] = Counter()
    for way in ways:
        if way.tags.get("junction") not in ("roundabout", "circular"):
            continue
        for points in _points(way, positions_m):
            if len(points) >= 3:
                steps = np.diff(points, axis=0)
                bend = steps[:-1, 0] * steps[1:, 1] - steps[:-1, 1] * steps[1:, 0]
                if abs(bend.sum()) > 1e-6:
                    votes[bool(bend.sum() < 0.0)] += 1
    return votes


def _carriageways(ways: list[Way], positions_m: FloatArray) -> Counter[bool]:
    """The other carriageway lies on the right where traffic keeps left."""
    votes: Counter[bool] = Counter()
    starts, ends, names = [], [], []
    for way in ways:
        name = way.tags.get("name") or way.tags.get("ref")
        if name and is_oneway(way.tags) and way.tags.get("junction") is None:
            for points in _points(way, positions_m):
                starts.append(points[:-1])
                ends.append(points[1:])
                names += [name] * (len(points) - 1)
    if not names:
        return votes
    begin, end = np.concatenate(starts), np.concatenate(ends)
    middle, step = 0.5 * (begin + end), end - begin
    step /= np.hypot(*step.T)[:, None]
    segments = shapely.linestrings(np.stack([begin, end], axis=1))
    tree = shapely.STRtree(segments)
    low_m, high_m = _CARRIAGEWAYS_M
    one, other = tree.query(shapely.points(middle), predicate="dwithin", distance=high_m)
    is_opposite = np.einsum("ij,ij->i", step[one], step[other]) < -0.95
    one, other = one[is_opposite], other[is_opposite]
    apart = middle[other] - middle[one]
    across = step[one, 0] * apart[:, 1] - step[one, 1] * apart[:, 0]  # > 0: on the left
    is_beside = (np.abs(across) >= low_m) & (np.abs(across) <= high_m)
    for index in np.flatnonzero(is_beside):
        if names[one[index]] == names[other[index]]:
            votes[bool(across[index] < 0.0)] += 1
    return votes
