"""Layouts to compare with: random ones, and an expert's rule of thumb.

All of them are within the same limits as the layout itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain, pairwise

import numpy as np
from shapely import Polygon

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.junction import Arm, Junction, Line, build_junction, lane_line
from geometry.scene import Scene

from .candidates import CandidatePose
from .optimiser import Limits, PlacementProblem, apr, run_margins_s
from .optimiser.allowed_sets import fitting, is_allowed

# Random layouts that are drawn to compare with.
N_RANDOM = 100

# For each random layout: limits may leave some draws no way to be completed.
_MAX_TRIES = 20
# Of a lane next to the junction that says where the lane leads.
_MOUTH_M = 10.0


# ---------- random layouts
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RandomLayouts:
    """What layouts of poses drawn at random prevent, on the detection table.

    Attributes
    ----------
    n_units : int
        Units of each layout.
    apr : (n,) float
        Accident prevention ratio of each, 0..1.
    mean_by_world : (n_worlds,) float
        Mean of all in each sampled world; one number where nothing was sampled.
    """

    n_units: int
    apr: FloatArray
    mean_by_world: FloatArray

    @property
    def mean(self) -> float:
        """Of all."""
        return float(self.apr.mean())

    @property
    def low(self) -> float:
        """5 % of them prevent no more."""
        return float(np.quantile(self.apr, 0.05))

    @property
    def high(self) -> float:
        """5 % of them prevent no less."""
        return float(np.quantile(self.apr, 0.95))


def random_sets(
    limits: Limits, n_units: int, *, n: int = N_RANDOM, rng: np.random.Generator
) -> tuple[tuple[int, ...], ...]:
    """Sets of poses drawn at random within the limits.

    Each begins with the poses that are forced. Then one pose after the other is drawn,
    any of those that the limits still admit as likely as another. What cannot be
    completed is drawn anew.

    Parameters
    ----------
    limits : Limits
        What may be mounted together; no set exceeds them.
    n_units : int
        Poses of each set, those that are forced among them.
    n : int
        Sets to draw.
    rng : Generator
        Of random numbers: the same one gives the same sets.

    Returns
    -------
    sets : tuple of tuple of int
        Rows, ascending. A set may be drawn twice. There are fewer where the limits
        leave hardly any set of that size, or none.

    Raises
    ------
    InputError
        A number is below 1.
    """
    # Every set begins with the forced poses; the draws below share what is free.
    forced = tuple(np.flatnonzero(limits.is_forced).tolist())

    # Every set begins alike.
    @cache
    def free(units: tuple[int, ...]) -> IntArray:
        return np.flatnonzero(fitting(limits, np.array(units, dtype=np.intp)))

    @cache
    def allowed(units: tuple[int, ...]) -> bool:
        return is_allowed(limits, units)

    # Draw sets until there are enough, or the tries are used up.
    sets: list[tuple[int, ...]] = []
    for _ in range(n * _MAX_TRIES):
        units = forced
        # Add poses at random until the set is full or nothing fits any more.
        while len(units) < n_units and len(free(units)):
            units = (*units, int(rng.choice(free(units))))
        units = tuple(sorted(units))
        if len(units) == n_units and allowed(units):
            sets.append(units)
        if len(sets) == n:
            break
    return tuple(sets)


# ---------- an expert's rule of thumb
def find_corners(junction: Junction) -> dict[str, FloatArray]:
    """Corners between neighbouring arms, clockwise from north.

    Named by the two arms, "north/west": midway between where their kerbs reach the
    junction, (2,), world frame, in metres. An arm that is alone has none.
    """
    arms = [*junction.arms.values()]
    if len(arms) < 2:
        return {}
    # A corner is midway between the right kerb of one arm and the left of the next.
    corners = {
        f"{arm.name}/{following.name}": 0.5
        * (_kerbs_m(arm)[0] + _kerbs_m(following)[1])
        for arm, following in pairwise([*arms, arms[0]])
    }
    middle = np.mean([*corners.values()], axis=0)

    # Clockwise from north.
    def bearing_deg(corner: tuple[str, FloatArray]) -> float:
        east, north = corner[1] - middle
        return float(np.degrees(np.arctan2(east, north))) % 360.0

    return dict(sorted(corners.items(), key=bearing_deg))


def _kerbs_m(arm: Arm) -> tuple[FloatArray, FloatArray]:
    """Left and right end of an arm's kerbs at the junction, (2,) each.

    Left and right are as seen from the junction's middle.
    """
    edges: list[FloatArray] = []
    outward: Line | None = None
    # Collect both edges of every lane at its mouth.
    for lanes, is_in in ((arm.lanes_in, True), (arm.lanes_out, False)):
        for lane in lanes:
            line, _ = lane_line(lane, is_in=is_in, length_m=_MOUTH_M)
            # away from the junction
            if is_in:
                line = line.turned(180.0)
            outward = outward or line
            edges += [line.at(0.0, side * 0.5 * lane.width_m) for side in (1.0, -1.0)]
    # An arm has lanes: that is how it was found.
    assert outward is not None
    # The outermost edges are the kerbs.
    to_the_left = outward.coordinates(np.array(edges))[:, 1]
    return edges[int(to_the_left.argmax())], edges[int(to_the_left.argmin())]


def middle_m(scene: Scene) -> FloatArray:
    """Middle of a junction: the centroid of its road surface, on the road, (3,)."""
    centroid = Polygon(scene.outline_m).centroid
    return np.array([centroid.x, centroid.y, 0.0])


def off_axis_deg(poses: Sequence[CandidatePose], point_m: FloatArray) -> FloatArray:
    """Angles between where poses look and the direction to a point.

    `point_m` is (3,); angles are (n_poses,), in degrees.
    """
    position = np.array([unit.pose.position_m for unit in poses]).reshape(-1, 3)
    yaw = np.radians([unit.pose.yaw_deg for unit in poses])
    pitch = np.radians([unit.pose.pitch_deg for unit in poses])
    # Unit vectors along the optical axes, (n_poses, 3).
    ahead = np.stack(
        [np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)], 1
    )
    to_point = point_m - position
    # The angle by its tangent is exact for small angles, too.
    beside = np.linalg.norm(np.cross(ahead, to_point), axis=1)
    return np.asarray(np.degrees(np.arctan2(beside, (ahead * to_point).sum(axis=1))))


def corner_poses(
    limits: Limits,
    candidates: Sequence[CandidatePose],
    junction: Junction,
    looked_at_m: FloatArray,
) -> dict[str, int]:
    """At each corner, the pose that looks at a point most directly.

    `looked_at_m` is the point, (3,), in the world frame. Each corner has a site of
    its own: the nearest one, and where two corners want the same, those that are
    the nearest in sum. Corners for which there is no site are left out. Poses and
    sites that are forbidden do not count; of poses that look equally directly the
    first one does.

    Returns
    -------
    rows : dict of str to int
        Candidates by the names of the corners, clockwise from north.
    """
    from scipy.optimize import linear_sum_assignment

    best = _most_direct(limits, candidates, looked_at_m)
    corners = find_corners(junction)
    sites = [*best]
    if not corners or not sites:
        return {}
    on_ground = np.array([candidates[row].pose.position_m[:2] for row in best.values()])
    # Distance of every site (columns) from every corner (rows).
    distance_m = np.array(
        [np.hypot(*(on_ground - corner).T) for corner in corners.values()]
    )
    # Assign sites to corners so that the sum of distances is smallest.
    pairs = zip(*linear_sum_assignment(distance_m), strict=True)
    names = [*corners]
    return {names[corner]: best[sites[site]] for corner, site in pairs}


def _most_direct(
    limits: Limits, candidates: Sequence[CandidatePose], looked_at_m: FloatArray
) -> dict[int, int]:
    """By site, the row of the pose that looks at a point most directly.

    Sites that may carry nothing are left out.
    """
    sites = limits.site_index
    off_deg = off_axis_deg(candidates, looked_at_m).round(6)
    # Stable: of equally direct ones the first comes first.
    order = np.lexsort([off_deg, sites])
    # Forbidden poses and sites without room do not count.
    order = order[
        ~limits.is_forbidden[order] & (limits.site_capacity[sites[order]] > 0)
    ]
    # The first row of each site is its most direct pose.
    used, first = np.unique(sites[order], return_index=True)
    return dict(zip(used.tolist(), order[first].tolist(), strict=True))


# ---------- both
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BaselineRows:
    """Rows of candidates to compare a layout with.

    They are chosen before anything is known of what they detect.

    Attributes
    ----------
    n_units : int
        Of each random layout; the expert's has at most as many.
    random : tuple of tuple of int
        See :func:`random_sets`.
    forced : tuple of int
        For each site that must carry a unit, the one there that looks at the junction's
        middle the most directly.
    corners : dict of str to int
        See :func:`corner_poses`.
    """

    n_units: int
    random: tuple[tuple[int, ...], ...]
    forced: tuple[int, ...]
    corners: dict[str, int]

    @property
    def rows(self) -> tuple[int, ...]:
        """All rows that occur, ascending."""
        return tuple(
            sorted({*chain(*self.random), *self.forced, *self.corners.values()})
        )

    def among(self, rows: Sequence[int]) -> "BaselineRows":
        """Proposals in terms of some of the rows, which have all that they need."""
        index = {row: number for number, row in enumerate(rows)}
        return replace(
            self,
            random=tuple(tuple(index[row] for row in units) for units in self.random),
            forced=tuple(index[row] for row in self.forced),
            corners={name: index[row] for name, row in self.corners.items()},
        )


def propose(
    limits: Limits,
    candidates: Sequence[CandidatePose],
    scene: Scene,
    *,
    n_units: int,
    rng: np.random.Generator,
) -> BaselineRows:
    """Propose random layouts, and the poses of an expert's rule of thumb.

    Raises InputError where the scene has no junction.
    """
    middle = middle_m(scene)
    direct = _most_direct(limits, candidates, middle)
    forced_sites = np.flatnonzero(limits.is_forced_site).tolist()
    return BaselineRows(
        n_units=n_units,
        random=random_sets(limits, n_units, rng=rng),
        forced=tuple(direct[site] for site in forced_sites if site in direct),
        corners=corner_poses(limits, candidates, build_junction(scene), middle),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JudgedBaselines:
    """What there is to compare a layout with.

    Attributes
    ----------
    random : RandomLayouts, optional
        None where no random layout is within the limits.
    expert : tuple of int
        Rows of the detection table, ascending; empty where the rule is not within the
        limits.
    corners : tuple of str
        Corners whose camera is among them, in the order of choice.
    """

    random: RandomLayouts | None
    expert: tuple[int, ...]
    corners: tuple[str, ...]


def judge_proposals(
    problem: PlacementProblem, proposals: BaselineRows
) -> JudgedBaselines:
    """What proposals are worth on a detection table, whose rows are theirs.

    The expert mounts what is forced, then a camera at each corner of the junction that
    looks at its middle: the corner whose camera prevents the most by itself comes
    first, of equal ones the first clockwise from north. Corners whose camera does not
    fit into the limits are passed over. Targets do not matter, only what may be mounted
    together.
    """
    limits = problem.limits
    corners = proposals.corners
    units = np.flatnonzero(limits.is_forced)
    # Corners by what their camera prevents alone, the best first.
    first = sorted(corners, key=lambda name: -apr(problem, [corners[name]]))
    for row in (*proposals.forced, *(corners[name] for name in first)):
        if len(units) < proposals.n_units and fitting(limits, units)[row]:
            units = np.append(units, row)
    # The expert's layout counts only if it is within the limits.
    is_complete = len(units) > 0 and is_allowed(limits, units)
    if is_complete:
        expert = tuple(sorted(units.tolist()))
    else:
        expert = ()
    random = None
    # Random layouts are judged by their margins in every run.
    if proposals.random:
        measure = problem.measure()
        margins_s = np.array(
            [run_margins_s(problem, units) for units in proposals.random]
        )
        is_avoided: BoolArray = margins_s > -np.inf
        share = is_avoided.mean(axis=0)
        by_world = [
            np.average(share, weights=measure.weight * (measure.sample_index == world))
            for world in range(len(measure.sample_weight))
        ]
        random = RandomLayouts(
            n_units=proposals.n_units,
            apr=measure.of(is_avoided),
            mean_by_world=np.array(by_world),
        )
    corner_names = tuple(name for name in first if corners[name] in expert)
    return JudgedBaselines(random=random, expert=expert, corners=corner_names)
