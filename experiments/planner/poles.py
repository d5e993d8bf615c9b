"""Poles of one's own, beside the sites of the scene: put, moved, taken away."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import shapely
from msgspec import Struct

from geometry.errors import refuse
from geometry.phrases import Phrase
from geometry.scene import Scene, Site, containing_instance, road_area
from geometry.tables import pick
from geometry.terrain import ground_height_m
from placement.candidates import CandidatePose
from placement.retrofit import free_name

from ..language import mark
from .plan import PlanState, check_finite, printable_name
from .requests import PutPole

# From the outline of the junction
_FARTHEST_POLE_M = 500.0
_SAME_PLACE_M = 0.01


class PolePlace(Struct, frozen=True):
    """A pole of one's own in a file; its height and what it carries are as the scene's.

    Attributes
    ----------
    id : str
        Its name, which units on it have as their site.
    x_m, y_m : float
        Place in the world frame, east and north.
    """

    id: str
    x_m: float
    y_m: float


@lru_cache(maxsize=8)
def with_poles(scene: Scene, poles: tuple[Site, ...]) -> Scene:
    """A scene with further sites; of the same ones always the same scene.

    Whoever remembers something by the scene finds it again.
    """
    return replace(scene, sites=(*scene.sites, *poles))


def build_pole(scene: Scene, name: str, place_m: tuple[float, float]) -> Site:
    """A pole as most of a scene's are, at another place.

    Parameters
    ----------
    scene : Scene
        Says what is usual, and what stands in the way.
    name : str
        Of the pole.
    place_m : tuple of float
        East and north in the world frame, rounded to centimetres here.

    Raises
    ------
    InputError
        It would stand in something or on the road, too far away, or no pole of the
        scene says what is usual.
    """
    standing = [site for site in scene.sites if site.kind != "mast arm"]
    if not standing:
        refuse(
            mark("pole"),
            mark("a scene without any"),
            mark("a scene with poles to copy the height from"),
        )
    # The first of those that are alike the most often
    kinds = [
        (one.kind, *one.height_range_m.tolist(), one.capacity_units) for one in standing
    ]
    usual_kind = max(kinds, key=kinds.count)
    usual = standing[kinds.index(usual_kind)]
    east_m, north_m = (round(check_finite(mark("pole"), value), 2) for value in place_m)
    point = shapely.Point(east_m, north_m)
    foot_m = np.array([east_m, north_m, 0.0])
    if not shapely.dwithin(point, shapely.Polygon(scene.outline_m), _FARTHEST_POLE_M):
        expected = Phrase(
            "one at most {far:g} m from the junction", far=_FARTHEST_POLE_M
        )
        refuse(mark("pole"), mark("a place farther away"), expected)
    foot_m[2] = ground_height_m(scene, foot_m[:2])
    # A metre above the ground, where what stands there is no mere edge.
    around = containing_instance(scene, foot_m + [0.0, 0.0, 1.0])
    if around:
        refuse(
            mark("pole"),
            Phrase(
                "a place inside {kind} {name}", kind=around.class_name, name=around.id
            ),
            mark("one in the open air"),
        )
    if road_area(scene).contains(point):
        refuse(mark("pole"), mark("a place on the carriageway"), mark("one beside it"))
    return replace(usual, id=name, position_m=foot_m, use="free")


def _own_pole(state: PlanState, name: str) -> Site:
    """A pole of one's own by its name; InputError: there is none."""
    by_name = {pole.id: pole for pole in state.poles}
    return pick(by_name, name, mark("pole"))


def put_pole(state: PlanState, change: PutPole, scene: Scene) -> PlanState:
    """The state with a further pole, or with one at another place and all that hangs on it.

    Raises InputError: there is no such pole, or none can stand there.
    """
    place_m = (change.east_m, change.north_m)
    if not change.site:
        name = free_name({site.id for site in scene.sites}, "own-")
        pole = build_pole(scene, name, place_m)
        return replace(state, poles=(*state.poles, pole))
    before = _own_pole(state, change.site)
    after = build_pole(scene, before.id, place_m)

    def moved(unit: CandidatePose) -> CandidatePose:
        if unit.site_id != before.id:
            return unit
        at_m = unit.pose.position_m + after.position_m - before.position_m
        pose = replace(unit.pose, position_m=at_m)
        return replace(unit, pose=pose)

    poles = tuple(after if pole is before else pole for pole in state.poles)
    return replace(_each_unit(state, moved), poles=poles)


def _each_unit(
    state: PlanState, change: Callable[[CandidatePose], CandidatePose]
) -> PlanState:
    """The state with each unit of each variant changed."""
    variants = []
    for variant in state.variants:
        units = tuple(change(unit) for unit in variant.units)
        variants.append(replace(variant, units=units))
    return replace(state, variants=tuple(variants))


def remove_pole(state: PlanState, name: str) -> PlanState:
    """The state without a pole; InputError: there is none, or it carries a unit."""
    pole = _own_pole(state, name)
    for variant in state.variants:
        for unit in variant.units:
            if unit.site_id == name:
                got = Phrase(
                    "{pole}, which carries {unit} of {variant}",
                    pole=name,
                    unit=unit.id,
                    variant=variant.name,
                )
                refuse(mark("pole"), got, mark("one that carries nothing"))
    others = tuple(one for one in state.poles if one is not pole)
    return replace(state, poles=others)


def lay_poles(state: PlanState, places: Sequence[PolePlace], scene: Scene) -> PlanState:
    """The state with the poles of a file, where none is yet, and what hangs on them.

    Parameters
    ----------
    state : PlanState
        With the units of the file already.
    places : sequence of PolePlace
        The poles; one whose name is taken gets another one.
    scene : Scene
        The scene without poles of one's own.

    Raises
    ------
    InputError
        A pole cannot stand there.
    """
    for place in places:
        place_m = (place.x_m, place.y_m)
        if any(_is_at(pole, place_m) for pole in state.poles):
            continue
        # A file may be of a scene that has a site of the same name.
        ids = {site.id for site in (*scene.sites, *state.poles)}
        name = place.id
        if name in ids:
            name = free_name(ids, "own-")
        pole = build_pole(scene, printable_name(name), place_m)
        state = replace(state, poles=(*state.poles, pole))

    def hung(unit: CandidatePose) -> CandidatePose:
        if unit.site_id:
            return unit
        for pole in state.poles:
            if _is_at(pole, unit.pose.position_m):
                return replace(unit, site_id=pole.id)
        return unit

    return _each_unit(state, hung)


def _is_at(pole: Site, place_m: Any) -> bool:
    """True if a pole stands at a place, whatever its height."""
    return math.dist(pole.position_m[:2], place_m[:2]) < _SAME_PLACE_M
