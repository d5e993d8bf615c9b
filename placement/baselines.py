"""Layouts to compare with: random ones within the same limits, and an expert's rule of thumb."""

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

N_RANDOM = 100  # random layouts that are drawn to compare with

_MAX_TRIES = (
    20  # for each random layout: limits may leave some draws no way to be completed
)
_MOUTH_M = 10.0  # of a lane next to the junction that says where the lane leads


# ---------- random layouts
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RandomLayouts:
    """Worth of layouts of poses drawn at random, on the detection table."""

    n_units: int  # of each
    apr: FloatArray  # (n,): accident prevention ratio of each, 0..1
    # (n_worlds,): mean of all in each sampled world; one number where nothing was
    # sampled
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
    """Sets of `n_units` ascending rows drawn at random within the limits, forced ones among them.

    One pose after the other is drawn, any that the limits still admit as likely as
    another; what cannot be completed is drawn anew. There are `n`, one perhaps twice;
    fewer where the limits leave hardly any.
    """
    forced = tuple(np.flatnonzero(limits.is_forced).tolist())

    @cache  # every set begins alike
    def free(units: tuple[int, ...]) -> IntArray:
        return np.flatnonzero(fitting(limits, np.array(units, dtype=np.intp)))

    @cache
    def allowed(units: tuple[int, ...]) -> bool:
        return is_allowed(limits, units)

    sets: list[tuple[int, ...]] = []
    for _ in range(n * _MAX_TRIES):
        units = forced
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
    """Corners between neighbouring arms, clockwise from the first one behind north.

    Named by the two arms, "north/west": midway between where their kerbs reach the
    junction, (2,), world frame, in metres. An arm that is alone has none.
    """
    arms = [*junction.arms.values()]
    if len(arms) < 2:
        return {}
    corners = {
        f"{arm.name}/{following.name}": 0.5
        * (_kerbs_m(arm)[0] + _kerbs_m(following)[1])
        for arm, following in pairwise([*arms, arms[0]])
    }
    middle = np.mean([*corners.values()], axis=0)

    def bearing_deg(corner: tuple[str, FloatArray]) -> float:  # clockwise from north
        east, north = corner[1] - middle
        return float(np.degrees(np.arctan2(east, north))) % 360.0

    return dict(sorted(corners.items(), key=bearing_deg))


def _kerbs_m(arm: Arm) -> tuple[FloatArray, FloatArray]:
    """Where an arm's kerbs reach the junction: seen from its middle the left and the right one."""
    edges: list[FloatArray] = []
    outward: Line | None = None
    for lanes, is_in in ((arm.lanes_in, True), (arm.lanes_out, False)):
        for lane in lanes:
            line, _ = lane_line(lane, is_in=is_in, length_m=_MOUTH_M)
            # away from the junction
            if is_in:
                line = line.turned(180.0)
            else:
                line = line
            outward = outward or line
            edges += [line.at(0.0, side * 0.5 * lane.width_m) for side in (1.0, -1.0)]
    assert outward is not None  # an arm has lanes: that is how it was found
    to_the_left = outward.coordinates(np.array(edges))[:, 1]
    return edges[int(to_the_left.argmax())], edges[int(to_the_left.argmin())]


def middle_m(scene: Scene) -> FloatArray:
    """Middle of a junction: the centroid of its road surface, on the road, (3,)."""
    centroid = Polygon(scene.outline_m).centroid
    return np.array([centroid.x, centroid.y, 0.0])


def off_axis_deg(poses: Sequence[CandidatePose], point_m: FloatArray) -> FloatArray:
    """Angles between where poses look and the direction to a point (3,), (n_poses,) in degrees."""
    position = np.array([unit.pose.position_m for unit in poses]).reshape(-1, 3)
    yaw = np.radians([unit.pose.yaw_deg for unit in poses])
    pitch = np.radians([unit.pose.pitch_deg for unit in poses])
    ahead = np.stack(
        [np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)], 1
    )
    to_point = point_m - position
    beside = np.linalg.norm(np.cross(ahead, to_point), axis=1)
    return np.asarray(np.degrees(np.arctan2(beside, (ahead * to_point).sum(axis=1))))


def corner_poses(
    limits: Limits,
    candidates: Sequence[CandidatePose],
    junction: Junction,
    looked_at_m: FloatArray,
) -> dict[str, int]:
    """The pose at each corner of a junction that looks at a point (3,) the most directly.

    Each corner has a site of its own, the nearest ones in sum; a corner without is left
    out, and so are forbidden poses. Of equally direct poses the first counts. Rows by
    names of corners.
    """
    from scipy.optimize import linear_sum_assignment

    best = _most_direct(limits, candidates, looked_at_m)
    corners = find_corners(junction)
    sites = [*best]
    if not corners or not sites:
        return {}
    on_ground = np.array([candidates[row].pose.position_m[:2] for row in best.values()])
    distance_m = np.array(
        [np.hypot(*(on_ground - corner).T) for corner in corners.values()]
    )
    pairs = zip(*linear_sum_assignment(distance_m), strict=True)
    names = [*corners]
    return {names[corner]: best[sites[site]] for corner, site in pairs}


def _most_direct(
    limits: Limits, candidates: Sequence[CandidatePose], looked_at_m: FloatArray
) -> dict[int, int]:
    """At each site that may carry something, the row of the pose that looks there most directly."""
    sites = limits.site_index
    off_deg = off_axis_deg(candidates, looked_at_m).round(6)
    order = np.lexsort(
        [off_deg, sites]
    )  # stable: of equally direct ones the first comes first
    order = order[
        ~limits.is_forbidden[order] & (limits.site_capacity[sites[order]] > 0)
    ]
    used, first = np.unique(sites[order], return_index=True)
    return dict(zip(used.tolist(), order[first].tolist(), strict=True))


# ---------- both
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proposals:
    """Layouts to compare with, before their detections are known: rows of candidates."""

    n_units: int  # of each random layout; the expert's has at most as many
    random: tuple[tuple[int, ...], ...]  # see :func:`random_sets`
    # for each site that must carry a unit, the one there that looks at the junction's
    # middle the most directly
    forced: tuple[int, ...]
    corners: dict[str, int]  # see :func:`corner_poses`

    @property
    def rows(self) -> tuple[int, ...]:
        """All rows that occur, ascending."""
        return tuple(
            sorted({*chain(*self.random), *self.forced, *self.corners.values()})
        )

    def among(self, rows: Sequence[int]) -> "Proposals":
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
) -> Proposals:
    """Random layouts of so many units, and the poses that an expert's rule of thumb knows.

    Raises InputError where the scene has no junction.
    """
    middle = middle_m(scene)
    direct = _most_direct(limits, candidates, middle)
    forced_sites = np.flatnonzero(limits.is_forced_site).tolist()
    return Proposals(
        n_units=n_units,
        random=random_sets(limits, n_units, rng=rng),
        forced=tuple(direct[site] for site in forced_sites if site in direct),
        corners=corner_poses(limits, candidates, build_junction(scene), middle),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Baselines:
    """Layouts to compare a layout with."""

    random: RandomLayouts | None  # None where no random layout is within the limits
    # rows of the detection table, ascending; empty where the rule is not within the
    # limits
    expert: tuple[int, ...]
    corners: tuple[
        str, ...
    ]  # corners whose camera is among them, in the order of choice


def judge_proposals(problem: PlacementProblem, proposals: Proposals) -> Baselines:
    """Worth of proposals on a detection table, whose rows are theirs.

    The expert mounts what is forced, then a camera at each corner that looks at the
    middle, those first that prevent the most by themselves, as far as they fit into the
    limits.
    """
    limits = problem.limits
    corners = proposals.corners
    units = np.flatnonzero(limits.is_forced)
    first = sorted(corners, key=lambda name: -apr(problem, [corners[name]]))
    for row in (*proposals.forced, *(corners[name] for name in first)):
        if len(units) < proposals.n_units and fitting(limits, units)[row]:
            units = np.append(units, row)
    is_complete = len(units) > 0 and is_allowed(limits, units)
    if is_complete:
        expert = tuple(sorted(units.tolist()))
    else:
        expert = ()
    random = None
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
    return Baselines(random=random, expert=expert, corners=corner_names)
