"""Vehicles that stand at random: parked, or waiting at stop lines."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from geometry.actors import Actor, PlacedActor
from geometry.arrays import BoolArray, FloatArray
from geometry.footprints import footprint_corners, footprint_separation
from geometry.junction import Arm, build_junction, lane_length_m, lane_line
from geometry.lines import points_at
from geometry.poses import Pose
from geometry.raycast import RayCaster, build_caster
from geometry.scene import Lane, Scene
from geometry.terrain import on_ground, set_down, terrain_of
from scenarios.aeb import AebRule, braking_distance_m, standstill_time_s
from scenarios.runs import Run

from .uncertainty import StandingTraffic, VehicleKind

# ---------- ways of VUT and VRU
# Along a way, from one footprint to the next.
_STEP_M = 0.25
# Bodies nearer than this stand in one another.
_TOGETHER_M = 1.0e-3

GroupKey = tuple[str, str, str]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Footprints:
    """Rectangles on the road, and circles around them.

    Attributes
    ----------
    corners_m : (n, 4, 2) float
        World frame. [m]
    middle_m : (2, n) float
        [m]
    radius_m : (n,) float
        [m]
    """

    corners_m: FloatArray
    middle_m: FloatArray
    radius_m: FloatArray

    def are_any_within(self, others: "Footprints", limit_m: FloatArray) -> BoolArray:
        """True for others, (n_others,), within a limit of any of these.

        `limit_m` is (n,): each of these has its own. The gap along one of the
        normals of two sides is at least the distance of the middles over the root
        of 2, less both radii.
        """
        # Circles first; rectangles only where these come near.
        east, north = self.middle_m[:, None, :] - others.middle_m[:, :, None]
        reach_m = limit_m + (self.radius_m + others.radius_m[:, None] + _TOGETHER_M)
        other, near = np.nonzero(east**2 + north**2 <= 2.0 * reach_m**2)
        gap_m = footprint_separation(self.corners_m[near], others.corners_m[other])
        is_within = np.zeros(len(others.corners_m), dtype=bool)
        is_within[other[gap_m <= limit_m[near]]] = True
        return is_within


def _footprints(corners_m: FloatArray) -> Footprints:
    """Footprints of rectangles (n, 4, 2), with circles around them."""
    diagonal = corners_m[:, 0] - corners_m[:, 2]
    return Footprints(
        corners_m=corners_m,
        middle_m=np.ascontiguousarray(0.5 * (corners_m[:, 0] + corners_m[:, 2]).T),
        radius_m=0.5 * np.hypot(diagonal[:, 0], diagonal[:, 1]),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ways:
    """Ground that runs of one case, approach and position sweep over.

    It is the same at any speed.

    Attributes
    ----------
    swept : Footprints
        Footprints of VUT and VRU, close to one another along their ways.
    reach_m : (n,) float
        Nothing of a body between two footprints is farther than this from the
        nearer one. [m]
    parked : Footprints
        Of the case's own obstructions.
    """

    swept: Footprints
    reach_m: FloatArray
    parked: Footprints

    def blocks(self, footprints: Footprints, *, clearance_m: float) -> BoolArray:
        """True for footprints, (n,), that are too near to a way.

        Those that stand in an obstruction count as well.
        """
        in_obstruction = np.full(len(self.parked.corners_m), _TOGETHER_M)
        return self.swept.are_any_within(
            footprints, clearance_m + self.reach_m
        ) | self.parked.are_any_within(footprints, in_obstruction)


def group_key(run: Run) -> GroupKey:
    """Runs of one group have the same ways but for the speed."""
    return run.case.name, run.approach, run.position


def build_ways(runs: Sequence[Run], rule: AebRule) -> dict[GroupKey, Ways]:
    """Ways of runs by group, see :func:`group_key`.

    The VUT may brake as late as at the impact: its way ends where it then stands, and
    the VRU's where it then is.
    """
    groups: dict[GroupKey, list[Run]] = {}
    for run in runs:
        groups.setdefault(group_key(run), []).append(run)
    return {key: _build(members, rule) for key, members in groups.items()}


def _footprints_of(bodies: Iterable[PlacedActor]) -> Footprints:
    """Footprints of bodies that stand somewhere; maybe none."""
    return _footprints(
        np.array([placed.footprint_m for placed in bodies]).reshape(-1, 4, 2)
    )


def touches_any(corners_m: FloatArray, others_m: Sequence[FloatArray]) -> bool:
    """True if a footprint touches one of others."""
    if not others_m:
        return False
    return bool(
        (footprint_separation(np.stack(others_m), corners_m) <= _TOGETHER_M).any()
    )


def _build(runs: Sequence[Run], rule: AebRule) -> Ways:
    """Ways of the runs of one group."""
    swept = []
    reach = []
    # In all weathers the encounter is one and the same.
    for encounter in {id(run.encounter): run.encounter for run in runs}.values():
        # The VUT brakes at the impact at the latest.
        speed_mps = encounter.vut_motion.speed_mps
        standstill_s = float(standstill_time_s(speed_mps, rule=rule))
        braking_m = float(
            braking_distance_m(standstill_s, speed_mps=speed_mps, rule=rule)
        )
        vut_end_m = float(encounter.vut_motion.distance_m(0.0)) + braking_m
        vru_end_m = float(encounter.vru_motion.distance_m(standstill_s))
        # Footprints of both along their ways, close to one another.
        for body, motion, end_m, turns in (
            (encounter.vut, encounter.vut_motion, vut_end_m, encounter.vut_reach),
            (encounter.vru, encounter.vru_motion, vru_end_m, encounter.vru_reach),
        ):
            place = motion.path.at(np.linspace(0.0, end_m, int(end_m / _STEP_M) + 2))
            corners = footprint_corners(
                *place, length_m=body.length_m, width_m=body.width_m
            )
            swept.append(corners)
            reach.append(np.full(len(corners), 0.5 * _STEP_M * turns))
    parked = {placed.key: placed for run in runs for placed in run.obstruction}
    return Ways(
        swept=_footprints(np.concatenate(swept)),
        reach_m=np.concatenate(reach),
        parked=_footprints_of(parked.values()),
    )


# ---------- vehicles that stand
# Above kerbs, below bonnets and walls; and just below each roof.
_HEIGHTS_M = (
    0.35,
    1.0,
)
_BELOW_ROOF_M = 0.1
# So much of a lane says where it points at its mouth.
_MOUTH_M = 10.0
_PARALLEL = 1.0e-3

Rng = Callable[..., np.random.Generator]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Kerbside:
    """One lane along which vehicles stand.

    Attributes
    ----------
    lane : Lane
        Of an arm.
    is_in : bool
        Whether it leads into the junction.
    first_m : float
        From the lane's mouth to the first place. [m]
    end_m : float
        From the lane's mouth to the end of the last one. [m]
    """

    lane: Lane
    is_in: bool
    first_m: float
    end_m: float

    def at(self, near_m: float, actor: Actor) -> PlacedActor:
        """A body on the lane, at a distance from the lane's mouth.

        It faces as the lane is driven.
        """
        # The end that is farther along the driving direction is the front.
        ends = [self._point(near_m), self._point(near_m + actor.length_m)]
        if self.is_in:
            rear, front = reversed(ends)
        else:
            rear, front = ends
        east, north = front - rear
        pose = Pose(
            position_m=np.append(0.5 * (rear + front), 0.0),
            yaw_deg=float(np.degrees(np.arctan2(north, east))),
        )
        return PlacedActor(actor=actor, pose=pose)

    def _point(self, from_mouth_m: float) -> FloatArray:
        """Point of the lane's centreline, (2,)."""
        if self.is_in:
            points = self.lane.centreline_m[::-1]
        else:
            points = self.lane.centreline_m
        return points_at(points, np.array(from_mouth_m))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StandingRoom:
    """Where in a scene vehicles may stand.

    Attributes
    ----------
    traffic : StandingTraffic
        How many, of which kinds.
    parking, entries, bus_lanes : tuple of Kerbside
        Parking lanes, and lanes that lead into the junction, for cars and for buses.
    solid : RayCaster
        Everything but the ground, relative to `origin_m`.
    origin_m : (3,) float
        Near the junction: rays are cast in single precision. [m]
    scene : Scene
        The scene, for the height of its ground.
    """

    traffic: StandingTraffic
    parking: tuple[Kerbside, ...]
    entries: tuple[Kerbside, ...]
    bus_lanes: tuple[Kerbside, ...]
    solid: RayCaster
    origin_m: FloatArray
    scene: Scene

    def draw(self, rng: Rng) -> tuple[PlacedActor, ...]:
        """Vehicles of one sampled world, clear of the scene and of one another.

        `rng` gives each thing its generator: what stands in one lane does not depend on
        the others.
        """
        kept: list[PlacedActor] = []
        taken: list[FloatArray] = []
        # Parked vehicles first, then those that wait.
        drawn = [
            placed
            for name, lanes, fill in (
                ("parking", self.parking, _park),
                ("waiting", self.entries, _queue),
                ("bus", self.bus_lanes, _stop),
            )
            for side in lanes
            for placed in fill(side, self.traffic, rng(name, side.is_in, side.lane.id))
        ]
        # Keep each one that touches neither another vehicle nor the scene.
        for placed in drawn:
            corners = placed.footprint_m
            if not touches_any(corners, taken) and self._is_free(
                corners, placed.actor.height_m
            ):
                kept.append(placed)
                taken.append(corners)
        return set_down(kept, self.scene)

    def _is_free(self, corners_m: FloatArray, height_m: float) -> bool:
        """True if nothing of the scene is on the sides and diagonals of a footprint."""
        heights = [h for h in (*_HEIGHTS_M, height_m - _BELOW_ROOF_M) if h < height_m]
        on_road = on_ground(corners_m, terrain_of(self.scene)) - self.origin_m
        starts, ends = (
            np.concatenate([on_road[order] + [0.0, 0.0, height] for height in heights])
            for order in ([0, 1, 2, 3, 0, 1], [1, 2, 3, 0, 2, 3])
        )
        vectors = (ends - starts).astype(np.float32)
        return not self.solid.is_blocked(starts.astype(np.float32), vectors).any()


def build_street(scene: Scene, traffic: StandingTraffic) -> StandingRoom:
    """Find where in a scene vehicles may stand.

    Raises InputError where there is no junction.
    """
    parking = []
    entries = []
    bus_lanes = []

    def kerbside(lane: Lane, is_in: bool, first_m: float) -> Kerbside:
        end_m = min(traffic.along_arm_m, lane_length_m(lane))
        return Kerbside(lane=lane, is_in=is_in, first_m=first_m, end_m=end_m)

    # Parking lanes of all arms, and entry lanes behind their stop lines.
    for arm in build_junction(scene).arms.values():
        for is_in, lanes in ((True, arm.lanes_in), (False, arm.lanes_out)):
            parking += [
                kerbside(lane, is_in, traffic.clear_of_mouth_m)
                for lane in lanes
                if lane.kind == "parking"
            ]
        entries += [
            kerbside(lane, True, stop_line_m(arm, lane, traffic.crosswalk_gap_m))
            for lane in arm.entry_lanes
        ]
        bus_lanes += [
            kerbside(lane, True, stop_line_m(arm, lane, traffic.crosswalk_gap_m))
            for lane in arm.lanes_in
            if lane.kind == "bus"
        ]
    origin = np.append(scene.outline_m.mean(axis=0), 0.0)
    solid = [
        i for i, thing in enumerate(scene.instances) if thing.class_name != "ground"
    ]
    triangles = np.asarray(scene.triangles)[np.isin(scene.triangle_instance, solid)]
    return StandingRoom(
        traffic=traffic,
        parking=tuple(parking),
        entries=tuple(entries),
        bus_lanes=tuple(bus_lanes),
        # Some hundred rays: not worth the second that Open3D takes to load.
        solid=build_caster(scene.vertices_m - origin, triangles, library="embree"),
        origin_m=origin,
        scene=scene,
    )


def stop_line_m(arm: Arm, lane: Lane, crosswalk_gap_m: float) -> float:
    """How far before a lane's mouth the first vehicle waits, at least 0 m.

    At the mouth, or `crosswalk_gap_m` before the line on which pedestrians cross.
    """
    # Parallel lines never cross: then vehicles wait at the mouth.
    line, _ = lane_line(lane, is_in=True, length_m=_MOUTH_M)
    if abs(line.left @ arm.crosswalk.direction) < _PARALLEL:
        return 0.0
    ahead_m = float(line.coordinates(line.crossing_with(arm.crosswalk))[0])
    return max(0.0, crosswalk_gap_m - ahead_m)


def clear_of_ways(
    vehicles: tuple[PlacedActor, ...],
    ways: Mapping[GroupKey, Ways],
    *,
    clearance_m: float,
) -> dict[GroupKey, tuple[PlacedActor, ...]]:
    """Vehicles that stand in nobody's way, by group of runs.

    Nobody stands nearer to a way than `clearance_m`: a vehicle that would has not come
    yet, or has left.
    """
    footprints = _footprints_of(vehicles)
    return {
        key: tuple(compress(vehicles, ~way.blocks(footprints, clearance_m=clearance_m)))
        for key, way in ways.items()
    }


def _park(
    side: Kerbside, traffic: StandingTraffic, rng: np.random.Generator
) -> Iterator[PlacedActor]:
    """Place after place is free, or taken by a vehicle as long as it is."""
    near_m = side.first_m
    while near_m < side.end_m:
        if rng.random() >= traffic.taken_share:
            near_m += traffic.free_place_m
            continue
        actor = _pick(traffic.vehicles, "parked_share", rng)
        if near_m + actor.length_m > side.end_m:
            return
        yield side.at(near_m, actor)
        near_m += actor.length_m + traffic.parked_gap_m


def _queue(
    side: Kerbside, traffic: StandingTraffic, rng: np.random.Generator
) -> Iterator[PlacedActor]:
    """One at the stop line or none; behind each, another one or none."""
    near_m = side.first_m
    share = traffic.waiting_share
    while rng.random() < share:
        actor = _pick(traffic.vehicles, "waiting_share", rng)
        if near_m + actor.length_m > side.end_m:
            return
        yield side.at(near_m, actor)
        near_m += actor.length_m + traffic.waiting_gap_m
        share = traffic.following_share


def _stop(
    side: Kerbside, traffic: StandingTraffic, rng: np.random.Generator
) -> Iterator[PlacedActor]:
    """A bus at the stop line of a bus lane, or none."""
    bus = traffic.bus
    if bus is None or rng.random() >= traffic.bus_lane_share:
        return
    if side.first_m + bus.length_m <= side.end_m:
        yield side.at(side.first_m, bus)


def _pick(kinds: Sequence[VehicleKind], use: str, rng: np.random.Generator) -> Actor:
    weights = np.array([getattr(kind, use) for kind in kinds])
    return kinds[int(rng.choice(len(kinds), p=weights / weights.sum()))].actor
