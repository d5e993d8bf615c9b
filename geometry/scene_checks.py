"""Look for mistakes in a scene.

These are holes, things that float or overlap, and sites inside walls, among
others.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import shapely

from .arrays import FloatArray
from .errors import InputError
from .junction import (
    ASSUMED,
    Junction,
    arm_of_road,
    build_junction,
    compass_point,
    lane_beside,
    lane_length_m,
)
from .lines import unit
from .notes import Finding
from .phrases import Phrase
from .scene import (
    HANGING_KINDS,
    LeadingRoad,
    Scene,
    Site,
    containing_instance,
    paved_area,
    road_area,
    strips_of,
)
from .terrain import HEADROOM_M, ground_height_m, standing_footprint

_FLOATING_M = 0.5
_SUNK_M = 3.0
_FLOOR_M = 0.1
_OVERLAP_M2 = 1.0
# Of the ground of two buildings that are one.
_SAME_SHARE = 0.8
_ON_ROAD_M2 = 2.0
_STANDING = ("building", "wall", "vegetation")
_MAX_NAMES = 6
# Digits of a file.
_AT_KERB_M = 0.05
# Cosine of the angle between lanes of one road; roads that cross meet at less.
_OPPOSITE = -0.8
# Along a lane, to tell its direction.
_BESIDE_M = 0.5


_error = partial(Finding, "error")
_warning = partial(Finding, "warning")


def check_scene(scene: Scene) -> list[Finding]:
    """Findings of what may be wrong with a scene, errors first."""
    checks = (_check_roads, _check_sites, _check_meshes, _check_footprints)
    findings = [finding for check in checks for finding in check(scene)]
    assumed_heights = sorted(
        thing.id for thing in scene.instances if thing.is_height_assumed
    )
    if assumed_heights:
        why = "the sources do not say how high it is: a usual height was taken"
        findings.append(_warning(_names(assumed_heights), why))
    return sorted(findings, key=lambda finding: finding.level)


def _check_roads(scene: Scene) -> Iterator[Finding]:
    """Findings about lanes, arms and crosswalks."""
    try:
        junction = build_junction(scene)
    except InputError:
        yield _error("lanes", "no lane ends at the junction's outline")
        return
    if not any(arm.entry_lanes for arm in junction.arms.values()):
        yield _error("lanes", "none leads into the junction")
    if len(junction.arms) < 3:
        yield _warning("arms", f"only {len(junction.arms)}: cars that turn need three")
    if not len(scene.crosswalks_m):
        yield _warning(
            "crosswalks", "none: pedestrians cross 2 m inside each arm's mouth"
        )
    if scene.roads:
        yield from compare_arms(junction, scene.roads)
    for name, why in arms_that_end(scene):
        yield _warning(f"arm {name}", why)
    crossed = [f"{one} and {other}" for one, other in lanes_that_cross(scene)]
    if crossed:
        why = (
            "they run in opposite directions and cross: one leads over the other's"
            " carriageway"
        )
        yield _warning(_names(crossed), why)


def lanes_that_cross(scene: Scene) -> Iterator[tuple[str, str]]:
    """Pairs of driving lanes that run against each other and cross, by id.

    It is their middles that cross.
    """
    lanes = [
        lane
        for lane in scene.lanes
        if lane.kind == "driving" and len(lane.centreline_m) > 1
    ]
    lines = np.array(
        [shapely.LineString(lane.centreline_m) for lane in lanes], dtype=object
    )
    if len(lines):
        pairs = shapely.STRtree(lines).query(lines, predicate="intersects").T
    else:
        pairs = ()
    # Each pair once.
    for one, other in ((a, b) for a, b in pairs if a < b):
        for point in shapely.get_coordinates(
            shapely.intersection(lines[one], lines[other])
        ):
            ways = [
                _direction(line, shapely.Point(point))
                for line in (lines[one], lines[other])
            ]
            if ways[0] @ ways[1] < _OPPOSITE:
                yield lanes[one].id, lanes[other].id
                break


def _direction(line: Any, point: Any) -> FloatArray:
    """Unit vector along a line, (2,), at the place nearest to a point."""
    at_m = line.project(point)
    begin, end = (
        line.interpolate(max(at_m + off_m, 0.0)) for off_m in (-_BESIDE_M, _BESIDE_M)
    )
    return unit(np.array([end.x - begin.x, end.y - begin.y]))


def arms_that_end(scene: Scene) -> Iterator[tuple[str, str]]:
    """Arms that the map does not follow far enough, and what is assumed.

    Far enough is as far as VUT and VRU come from.
    """
    junction = build_junction(scene)
    for name, arm in junction.arms.items():
        ending = [
            lane
            for lane in arm.entry_lanes
            if junction.is_led_on(lane) and lane_beside(lane, scene.lanes) is None
        ]
        ends_m = [lane_length_m(lane) for lane in ending]
        is_bent = any(junction.followed(lane) is not lane for lane in ending)
        if not ends_m:
            continue
        why = Phrase(
            "the map ends {far:.0f} m from the junction: road users from beyond are "
            "assumed to come straight on, with nothing to hide them",
            far=min(ends_m),
        )
        if is_bent:
            why = Phrase(
                "the map ends {far:.0f} m from the junction: road users from beyond "
                "are assumed to come round a bend, past the buildings there, with "
                "nothing else to hide them",
                far=min(ends_m),
            )
        yield name, why


def compare_arms(junction: Junction, roads: Sequence[LeadingRoad]) -> Iterator[Finding]:
    """Compare a junction's arms with the roads that lead to it.

    The arms were found by the junction's lanes.

    Parameters
    ----------
    junction : Junction
        See :func:`geometry.junction.build_junction`.
    roads : sequence of LeadingRoad
        Roads as the map has them.

    Yields
    ------
    finding : Finding
        A road that is part of no arm, an arm without a road, or an arm whose driving
        lanes are not those of its roads.
    """
    found: dict[str, list[LeadingRoad]] = {name: [] for name in junction.arms}
    for road in roads:
        name = arm_of_road(road, junction)
        if name is None:
            what = f"road {road.name} from the {compass_point(road.direction)}"
            yield _warning(
                what, "it leads to the junction, but no arm has a lane of it"
            )
        else:
            found[name].append(road)
    for name, here in found.items():
        arm = junction.arms[name]
        if not here:
            yield _warning(
                f"arm {name}", "no road of the map leads to the junction there"
            )
            continue
        has = len(arm.entry_lanes), len(arm.exit_lanes)
        said = sum(road.lanes_in for road in here), sum(road.lanes_out for road in here)
        if has != said:
            names = " and ".join(dict.fromkeys(road.name for road in here))
            why = (
                f"it has {has[0]} lanes in and {has[1]} out; by the map {names} has"
                f" {said[0]} in"
            )
            yield _warning(f"arm {name}", f"{why} and {said[1]} out")


def _check_sites(scene: Scene) -> Iterator[Finding]:
    """Findings about sites: in the air, in the ground, or inside a thing."""
    if not scene.sites:
        yield _error("sites", "none: nothing can be mounted")
    for site in scene.sites:
        for height_m in site.height_range_m:
            around = containing_instance(scene, site.position_m + [0.0, 0.0, height_m])
            if around is not None:
                why = (
                    f"its mount at {height_m:g} m is inside"
                    f" {around.class_name} {around.id}"
                )
                yield _error(f"site {site.id}", why)
                break
    for site in scene.sites:
        off_m = float(site.position_m[2] - ground_height_m(scene, site.position_m[:2]))
        if abs(off_m) > _FLOATING_M:
            why = (
                f"its foot is {abs(off_m):.1f} m"
                f" {'above' if off_m > 0.0 else 'below'} the ground"
            )
            yield _error(f"site {site.id}", why)
    standing = [site for site in scene.sites if site.kind not in HANGING_KINDS]
    if standing:
        yield from _check_feet(scene, standing)


def _check_feet(scene: Scene, sites: Sequence[Site]) -> Iterator[Finding]:
    """Errors for poles that stand on a lane or in the junction."""
    feet = np.array([site.position_m[:2] for site in sites])
    paved = paved_area(scene.outline_m, scene.islands_m)
    junction = paved.buffer(-_AT_KERB_M)
    mapped = [
        lane
        for lane in scene.lanes
        if lane.kind != ASSUMED and len(lane.centreline_m) > 1
    ]
    lanes = strips_of(mapped, less_m=_AT_KERB_M)
    hit, which = shapely.STRtree(lanes).query(shapely.points(feet), predicate="within")
    in_lane = {
        int(index): mapped[int(lane)].id for index, lane in zip(hit, which, strict=True)
    }
    in_middle = shapely.intersects_xy(junction, *feet.T)
    for index, site in enumerate(sites):
        if in_middle[index] or index in in_lane:
            if in_middle[index]:
                where = "in the junction"
            else:
                where = f"on lane {in_lane[index]}"
            why = (
                f"it stands {where}: no pole can (kinds that hang:"
                f" {', '.join(HANGING_KINDS)})"
            )
            yield _error(f"site {site.id}", why)


def _check_meshes(scene: Scene) -> Iterator[Finding]:
    """Findings about things: holes, heights and faces that look inwards."""
    import trimesh

    holes = "its surface has holes above the floor"
    floating = f"it begins more than {_FLOATING_M:g} m above the road"
    raised = (
        f"it begins {HEADROOM_M:g} m above the ground or higher: taken to be passed"
        " below"
    )
    sunk = "it is below the road, or begins far below it"
    inverted = "its triangles face inwards"
    found: dict[str, list[str]] = {
        why: [] for why in (holes, floating, raised, sunk, inverted)
    }
    for index, thing in enumerate(scene.instances):
        faces = scene.triangles[scene.triangle_instance == index]
        if thing.class_name not in _STANDING or not len(faces):
            continue
        # The mesh of this thing alone.
        used, local = np.unique(faces, return_inverse=True)
        mesh = trimesh.Trimesh(
            scene.vertices_m[used], local.reshape(-1, 3), process=False
        )
        mesh.merge_vertices()
        low, high = mesh.bounds[:, 2]
        ground_m = ground_height_m(scene, mesh.vertices[:, :2])
        least_m = (mesh.vertices[:, 2] - ground_m).min()
        if low - ground_m.min() > _FLOATING_M and thing.class_name != "vegetation":
            found[raised if least_m >= HEADROOM_M else floating].append(thing.id)
        if high < ground_m.min() or least_m < -_SUNK_M:
            found[sunk].append(thing.id)
        # A hole in the floor, which stands on the ground, lets nothing be seen through.
        edges = np.sort(mesh.edges, axis=1)
        _, first, count = np.unique(
            edges, axis=0, return_index=True, return_counts=True
        )
        # A triangle on one side.
        tops = mesh.vertices[edges[first[count == 1]]][..., 2].max(axis=1)
        if (tops > low + _FLOOR_M).any():
            found[holes].append(thing.id)
        elif mesh.is_watertight and mesh.volume < 0.0:
            found[inverted].append(thing.id)
    for why, ids in found.items():
        if ids:
            yield _warning(_names(ids), why)


def _check_footprints(scene: Scene) -> Iterator[Finding]:
    """Warnings of things that overlap on the ground or stand on the road."""
    things = enumerate(scene.instances)
    solid = [
        (one.id, at) for at, one in things if one.class_name in ("building", "wall")
    ]
    shapes = {name: standing_footprint(scene, index) for name, index in solid}
    shapes = {name: shape for name, shape in shapes.items() if shape.area > 0.0}
    names = list(shapes)
    areas = np.array(list(shapes.values()), dtype=object)
    if not names:
        return
    tree = shapely.STRtree(areas)
    one, other = tree.query(areas, predicate="intersects")
    one, other = one[one < other], other[one < other]
    overlaps = shapely.area(shapely.intersection(areas[one], areas[other]))
    twice = list[str]()
    partly = list[str]()
    for a, b, area in zip(one.tolist(), other.tolist(), overlaps.tolist(), strict=True):
        if area > _OVERLAP_M2:
            smaller_m2, larger_m2 = sorted((areas[a].area, areas[b].area))
            # Two buildings of about the same size that overlap are one and the same.
            is_same = (
                area > _SAME_SHARE * smaller_m2 and smaller_m2 > _SAME_SHARE * larger_m2
            )
            (twice if is_same else partly).append(f"{names[a]} and {names[b]}")
    for found, why in (
        (partly, "they overlap on the ground"),
        (twice, "they overlap on the ground: the same thing twice, as from two files"),
    ):
        if found:
            yield _warning(_names(found), why)
    road = road_area(scene)
    near = tree.query(road, predicate="intersects").tolist()
    on_road = [
        names[at] for at in near if areas[at].intersection(road).area > _ON_ROAD_M2
    ]
    if on_road:
        why = (
            "it stands on a lane or in the junction: cases that it is in the way of are"
            " refused"
        )
        yield _warning(_names(on_road), why)


def _names(ids: list[str]) -> str:
    """The first ids, with commas between, and how many are left."""
    left = len(ids) - _MAX_NAMES
    return ", ".join(ids[:_MAX_NAMES]) + (f" and {left} more" if left > 0 else "")
