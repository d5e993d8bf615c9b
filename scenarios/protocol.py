"""Cases laid on the approaches of any junction, by the rules of the protocol."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.resources import files

import numpy as np
from scipy.constants import kmh

from geometry.actors import Actor, PlacedActor
from geometry.arrays import FloatArray
from geometry.errors import InputError
from geometry.files import load_toml, read_table
from geometry.footprints import footprint_corners
from geometry.junction import (
    Arm,
    Junction,
    Line,
    lane_length_m,
    lane_line,
)
from geometry.raycast import RayCaster, build_caster
from geometry.scene import Lane, Scene

from .cases import Case
from .paths import Motion, Path, StraightPath, TurnPath, travel_time_s
from .staging import (
    CannotCarryError,
    Staging,
    find_meeting,
    impact_offset_m,
    place_beside_vru,
    place_beside_vut,
    place_wall,
    set_off,
)
from .turns import pick_turn


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rules:
    """``data/laying.toml``."""

    start_before_curve_s: float
    max_lane_bend_m: float
    max_skew_deg: float


@cache
def _load_rules() -> _Rules:
    table = load_toml(files(__package__) / "data" / "laying.toml")
    return read_table(table["vut"], _Rules, "laying.toml: vut")


def stage_by_protocol(
    case: Case, junction: Junction, approach: str, *, vut_speed_kmh: float, vut: Actor
) -> Staging:
    """Lay a case on an approach of a junction, or raise why its lanes do not allow it.

    The run begins when the VRU sets off; turning: also 1 s before the VUT enters the curve. The VUT
    comes along its lane, and straight on backwards where the map ends. It drives in the lane at the
    kerb; before a left turn, in the one at the road's axis. Pedestrians cross on the arm's
    crosswalk; a VRU that moves ahead of the VUT is reached there.

    Raises
    ------
    CannotCarryError
        The lanes do not allow it; the text says why.
    InputError
        There is no such arm.
    """
    if approach not in junction.arms:
        raise InputError("approach", approach, "one of " + ", ".join(junction.arms))
    arm = junction.arms[approach]
    if not arm.entry_lanes:
        raise CannotCarryError(f"no lane leads into the junction from the {approach}")
    lay = {"crossing": _lay_crossing, "longitudinal": _lay_longitudinal, "turning": _lay_turning}
    return lay[case.kind](case, junction, arm, vut_speed_kmh, vut)


def _lay_crossing(
    case: Case, junction: Junction, arm: Arm, vut_speed_kmh: float, vut: Actor
) -> Staging:
    lane = arm.entry_lanes[0]
    vut_line = _line(lane, is_in=True)
    vru_line = _crossing_line(case, junction, arm, vut_line)
    # Far enough back for any gap between the lines; the impact lies near their crossing.
    behind_m = 2.0 * (vut.length_m + case.vru.length_m)
    nominal_m = float(vut_line.coordinates(vru_line.point_m)[0])
    path = StraightPath(start_m=vut_line.at(nominal_m - behind_m), yaw_deg=vut_line.yaw_deg)
    meeting = find_meeting(
        case, vut=vut, vut_path=path, vru_line=vru_line, search_m=(0.0, 2.0 * behind_m)
    )
    travel_m = _travel_m(case, meeting.vru_distance_m)
    begin_s = -_travel_s(case, travel_m)
    driven_m = -begin_s * vut_speed_kmh * kmh
    _check_straight(lane, driven_m)
    encounter = set_off(
        case,
        vut=vut,
        vut_path=StraightPath(
            start_m=vut_line.at(nominal_m - behind_m + meeting.vut_distance_m - driven_m),
            yaw_deg=vut_line.yaw_deg,
        ),
        vut_start_s=begin_s,
        vut_speed_kmh=vut_speed_kmh,
        vru_line=vru_line,
        vru_distance_m=meeting.vru_distance_m,
        vru_travel_m=travel_m,
    )
    obstruction: tuple[PlacedActor, ...] = ()
    if case.obstruction is not None:
        place = {
            "beside-vut": place_beside_vut,
            "beside-vru": place_beside_vru,
            "wall": place_wall,
        }[case.obstruction.kind]
        obstruction = place(
            case.obstruction, vut=vut, vut_line=vut_line, vru=case.vru, vru_line=vru_line
        )
    return Staging(encounter=encounter, obstruction=obstruction)


def _lay_longitudinal(
    case: Case, junction: Junction, arm: Arm, vut_speed_kmh: float, vut: Actor
) -> Staging:
    lane = arm.entry_lanes[0]
    vut_line = _line(lane, is_in=True)
    offset_m = impact_offset_m(case, vut)
    impact_m = float(vut_line.coordinates(vut_line.crossing_with(arm.crosswalk))[0])
    travel_m = _travel_m(case, 0.0)
    before_lane_m = travel_m + 0.5 * case.vru.length_m - impact_m - lane_length_m(lane)
    if before_lane_m > 0.0:
        raise CannotCarryError(
            f"the VRU would set off {before_lane_m:.1f} m before the mapped lane begins"
        )
    begin_s = -_travel_s(case, travel_m)
    driven_m = -begin_s * vut_speed_kmh * kmh
    _check_straight(lane, max(travel_m, driven_m))
    gap_m = 0.5 * (vut.length_m + case.vru.length_m)
    encounter = set_off(
        case,
        vut=vut,
        vut_path=StraightPath(
            start_m=vut_line.at(impact_m - gap_m - driven_m), yaw_deg=vut_line.yaw_deg
        ),
        vut_start_s=begin_s,
        vut_speed_kmh=vut_speed_kmh,
        vru_line=Line(point_m=vut_line.at(impact_m, offset_m), direction=vut_line.direction),
        vru_distance_m=0.0,
        vru_travel_m=travel_m,
    )
    return Staging(encounter=encounter, obstruction=())


def _lay_turning(
    case: Case, junction: Junction, arm: Arm, vut_speed_kmh: float, vut: Actor
) -> Staging:
    rules = _load_rules()
    is_far = case.turn == "far"
    entry_lane = arm.entry_lanes[-1 if is_far else 0]
    entry = _line(entry_lane, is_in=True)
    target = _arm_at(junction, entry, to_left=is_far)
    if target is None or not target.exit_lanes:
        raise CannotCarryError(f"no lane leads out of the junction on the {case.turn} side")
    exit_lane = target.exit_lanes[-1 if is_far else 0]
    exit_line = _line(exit_lane, is_in=False)
    angle_deg = abs((exit_line.yaw_deg - entry.yaw_deg + 180.0) % 360.0 - 180.0)
    try:
        turn = pick_turn(case.turn, vut_speed_kmh)
    except InputError as error:
        raise CannotCarryError(str(error)) from None
    try:
        turn = turn.turned_by(angle_deg)
    except InputError:
        raise CannotCarryError(f"the arms meet at {angle_deg:.0f} degrees") from None
    corner = entry.crossing_with(exit_line)
    for lane, line, sign, what in (
        (entry_lane, entry, -1.0, "begin"),
        (exit_lane, exit_line, 1.0, "end"),
    ):
        in_lane_m = sign * float(line.coordinates(corner)[0]) + turn.tangent_m
        if in_lane_m > lane_length_m(lane):
            raise CannotCarryError(f"the turn would {what} beyond the mapped lane {lane.id}")

    vru_line = _turning_line(case, arm, target, entry, exit_line, is_far=is_far)

    def path_with(straight_m: float) -> TurnPath:
        before_corner_m = float(entry.coordinates(corner)[0]) - turn.tangent_m
        return TurnPath(
            start_m=entry.at(before_corner_m - straight_m),
            yaw_deg=entry.yaw_deg,
            straight_m=straight_m,
            turn=turn,
            wheelbase_m=vut.wheelbase_m,
            front_axle_ahead_m=vut.front_axle_ahead_m,
        )

    path = path_with(0.0)
    meeting = find_meeting(
        case,
        vut=vut,
        vut_path=path,
        vru_line=vru_line,
        search_m=(0.0, turn.length_m + lane_length_m(exit_lane)),
    )
    travel_m = _travel_m(case, meeting.vru_distance_m)
    speed_mps = vut_speed_kmh * kmh
    begin_s = -max(
        _travel_s(case, travel_m), meeting.vut_distance_m / speed_mps + rules.start_before_curve_s
    )
    straight_m = -begin_s * speed_mps - meeting.vut_distance_m
    _check_straight(entry_lane, straight_m)
    encounter = set_off(
        case,
        vut=vut,
        vut_path=path_with(straight_m),
        vut_start_s=begin_s,
        vut_speed_kmh=vut_speed_kmh,
        vru_line=vru_line,
        vru_distance_m=meeting.vru_distance_m,
        vru_travel_m=travel_m,
    )
    return Staging(encounter=encounter, obstruction=())


def _crossing_line(case: Case, junction: Junction, arm: Arm, vut_line: Line) -> Line:
    """The VRU's line, from where it crosses the VUT's."""
    assert case.vru_line is not None
    is_near = case.vru_side == "near"
    if case.vru_line.along == "crosswalk":
        point = vut_line.crossing_with(arm.crosswalk)
        return Line(point_m=point, direction=vut_line.left if is_near else -vut_line.left)
    side = _arm_at(junction, vut_line, to_left=not is_near)
    if side is None or not side.entry_lanes:
        raise CannotCarryError(f"no lane leads into the junction from the {case.vru_side} side")
    lane = side.entry_lanes[0 if case.vru_line.lane == "outer" else -1]
    middle = _line(lane, is_in=True)
    beside = Line(point_m=middle.at(0.0, case.vru_line.left_m), direction=middle.direction)
    return Line(point_m=beside.crossing_with(vut_line), direction=beside.direction)


def _turning_line(
    case: Case, arm: Arm, target: Arm, entry: Line, exit_line: Line, *, is_far: bool
) -> Line:
    """The VRU's line, from where it crosses the lane into which the VUT turns."""
    assert case.vru_line is not None
    direction = entry.direction if case.vru_direction == "same" else -entry.direction
    if case.vru_line.along == "crosswalk":
        return Line(point_m=exit_line.crossing_with(target.crosswalk), direction=direction)
    outside_m = case.vru_line.left_m
    if not is_far:
        kerb_lane, is_in, kerb_side = arm.lanes_in[0], True, -1.0
    elif arm.lanes_out:
        kerb_lane, is_in, kerb_side = arm.lanes_out[0], False, -1.0
    else:  # a one-way road: the kerb is to the left of its lanes
        kerb_lane, is_in, kerb_side = arm.lanes_in[-1], True, 1.0
    middle = _line(kerb_lane, is_in=is_in)
    beside = Line(
        point_m=middle.at(0.0, kerb_side * (0.5 * kerb_lane.width_m + outside_m)),
        direction=direction,
    )
    return Line(point_m=beside.crossing_with(exit_line), direction=direction)


def _arm_at(junction: Junction, vut_line: Line, *, to_left: bool) -> Arm | None:
    """The arm to the left or right of the VUT; None if there is none about at a right angle."""
    side = vut_line.left if to_left else -vut_line.left
    best, best_cosine = None, np.cos(np.radians(_load_rules().max_skew_deg))
    for arm in junction.arms.values():
        lanes, is_in = (arm.lanes_in, True) if arm.lanes_in else (arm.lanes_out, False)
        line = _line(lanes[0], is_in=is_in)
        cosine = float(line.direction @ side) * (-1.0 if is_in else 1.0)
        if cosine >= best_cosine:
            best, best_cosine = arm, cosine
    return best


_STRAIGHT_M = 50.0  # of a lane next to the junction, which gives its direction


def _line(lane: Lane, *, is_in: bool) -> Line:
    return lane_line(lane, is_in=is_in, length_m=_STRAIGHT_M)[0]


def _check_straight(lane: Lane, driven_m: float) -> None:
    _, off_line_m = lane_line(lane, is_in=True, length_m=min(driven_m, _STRAIGHT_M))
    if off_line_m > _load_rules().max_lane_bend_m:
        raise CannotCarryError(
            f"lane {lane.id} is not straight: {off_line_m:.1f} m off its line before the junction"
        )


def _travel_m(case: Case, vru_distance_m: float) -> float:
    """The VRU's way from rest to the impact; `vru_distance_m`: its middle past the line's point."""
    if case.steady_distance_m is not None:
        return case.acceleration_distance_m + case.steady_distance_m
    assert case.start_distance_m is not None
    return case.start_distance_m + vru_distance_m + case.vru_reference_m


def _travel_s(case: Case, travel_m: float) -> float:
    return travel_time_s(
        travel_m,
        speed_mps=case.vru_speed_kmh * kmh,
        acceleration_distance_m=case.acceleration_distance_m,
    )


# ---------- room for what a case lays into a scene


_HEIGHTS_M = (0.35, 1.0)  # above kerbs, below bonnets and walls
_STEP_M = 2.0  # along bent paths
_POLES = ("lamp post", "traffic light")


def check_clearance(staging: Staging, scene: Scene) -> None:
    """Check that nothing of the scene stands in the way of a staging's bodies.

    Raises
    ------
    CannotCarryError
        Names the body and what it would run into.

    Notes
    -----
    Looked at with rays along the middle and both flanks of the ways, and around and across the
    parked bodies' footprints. A VRU passes beside a pole that stands on its line. What the map does
    not show does not stand in the way.
    """
    encounter = staging.encounter
    solid = _Solid(scene=scene, has_poles=True)
    for name, body, motion, obstacles in (
        ("the VRU", encounter.vru, encounter.vru_motion, _Solid(scene=scene, has_poles=False)),
        ("the VUT", encounter.vut, encounter.vut_motion, solid),
    ):
        _check(obstacles, _way(motion, body), f"{name}'s way")
    for parked in staging.obstruction:
        _check(solid, _footprint_sides(parked), f"the place of {parked.actor.name}")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Solid:
    """What of a scene stands in a way."""

    scene: Scene
    has_poles: bool


def _check(solid: _Solid, segments_m: FloatArray, what: str) -> None:
    caster, origin = _caster(solid)
    starts, ends = (
        np.concatenate([_lift(segments_m[:, end] - origin, height) for height in _HEIGHTS_M])
        for end in (0, 1)
    )
    if _is_blocked(caster, starts, ends):
        raise CannotCarryError(f"{_blocker(solid, starts, ends, origin)} stands in {what}")


@lru_cache(maxsize=8)
def _caster(solid: _Solid) -> tuple[RayCaster, FloatArray]:
    """Rays against all of it, near the origin: they are cast in single precision."""
    origin = solid.scene.outline_m.mean(axis=0)
    return _caster_of(solid.scene, _counting(solid), origin), origin


def _counting(solid: _Solid) -> list[int]:
    """Indices of the instances that count."""
    return [
        index
        for index, instance in enumerate(solid.scene.instances)
        if solid.has_poles or instance.class_name not in _POLES
    ]


def _caster_of(scene: Scene, instances: Sequence[int], origin_m: FloatArray) -> RayCaster:
    triangles = np.asarray(scene.triangles)[np.isin(scene.triangle_instance, instances)]
    # A few thousand rays: not worth the second that Open3D takes to load.
    return build_caster(scene.vertices_m - [*origin_m, 0.0], triangles, library="embreex")


def _blocker(solid: _Solid, starts_m: FloatArray, ends_m: FloatArray, origin_m: FloatArray) -> str:
    """The first instance that the rays run into."""
    for index in _counting(solid):
        if _is_blocked(_caster_of(solid.scene, [index], origin_m), starts_m, ends_m):
            return solid.scene.instances[index].id
    return "the scene"


def _is_blocked(caster: RayCaster, starts_m: FloatArray, ends_m: FloatArray) -> bool:
    vectors = (ends_m - starts_m).astype(np.float32)
    return bool(caster.is_blocked(starts_m.astype(np.float32), vectors).any())


def _way(motion: Motion, body: Actor) -> FloatArray:
    """Segments along the middle and the flanks, from behind the start to the impact, (n, 2, 2)."""
    covered_m = float(motion.distance_m(0.0))
    distances = _distances(motion.path, covered_m)
    position, yaw_deg = motion.path.at(distances)
    yaw = np.radians(np.broadcast_to(yaw_deg, distances.shape))
    ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    left = np.stack([-np.sin(yaw), np.cos(yaw)], axis=-1)
    segments = []
    for share in (-0.5, 0.0, 0.5):
        line = position + share * body.width_m * left
        line = np.concatenate([line[:1] - 0.5 * body.length_m * ahead[:1], line])
        segments.append(np.stack([line[:-1], line[1:]], axis=1))
    return np.concatenate(segments)


def _distances(path: Path, covered_m: float) -> FloatArray:
    return np.linspace(0.0, covered_m, max(2, int(covered_m / _STEP_M) + 2))


def _footprint_sides(parked: PlacedActor) -> FloatArray:
    corners = footprint_corners(
        parked.pose.position_m[:2],
        parked.pose.yaw_deg,
        length_m=parked.actor.length_m,
        width_m=parked.actor.width_m,
    )
    ends = [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)]  # four sides, two diagonals
    return np.array([[corners[a], corners[b]] for a, b in ends])


def _lift(points_m: FloatArray, height_m: float) -> FloatArray:
    return np.column_stack([points_m, np.full(len(points_m), height_m)])
