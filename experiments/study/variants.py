"""Variants of the study's setting: one thing of ours, or that it leaves open, is changed."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.actors import PlacedActor, pick_actor
from geometry.catalogue import pick_camera
from geometry.poses import Pose, body_rotation
from geometry.scene import Scene
from geometry.study_scene import load_study_scene
from placement.detectors import GeometricDetector, load_planning_detector
from placement.layout import Layout, load_carlancap_layout
from placement.question import Question
from placement.setting import Setting, build_setting
from scenarios.aeb import load_track_memory_s
from scenarios.cases import Case, select_cases
from scenarios.positions import AT_ZERO, Position, is_bound, read_position
from scenarios.runs import Run, build_frame_axis, build_runs
from scenarios.weights import weight_per_run

OWN_CASES = "CPNC-50,CBNA,CBLA"
"""The cases whose starts and figures the study publishes."""
# At the junction alone, every run alike, a track for ever once confirmed.
AS_STUDIED = Question(cases=OWN_CASES, along_arms="0", weights="run", track_memory_s=math.inf)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Variant:
    """A setting with one thing changed, which its name says, and the study's 12 cameras in it."""

    name: str
    setting: Setting
    layout: Layout


def build_variants() -> tuple[Variant, ...]:
    """As it is first; then walls, parked cars, smallest box and field of view, changed."""
    base = build_setting(AS_STUDIED, load_study_scene())
    open_corner = move_walls(base.scene, -5.0)
    settings = {
        "as it is": base,
        "walls 0.5 m nearer to the corner": replace(base, scene=move_walls(base.scene, 0.5)),
        "walls 5 m farther from the corner": replace(base, scene=open_corner),
        "no parked cars": _keep_parked(base, 0),
        "no parked cars, walls 5 m farther": replace(_keep_parked(base, 0), scene=open_corner),
        "two parked cars instead of eight": _keep_parked(base, 2),
        "parked row 1 m beside the VUT, not 0.5 m": _move_parked(base, 0.5),
        "smallest box 30 px": _detect_from(base, 30.0),
        "smallest box 50 px": _detect_from(base, 50.0),
    }
    return _with_narrow(settings, {_NARROW: base})


_NARROW = "field of view 90 deg, not 110"


def _with_narrow(
    settings: Mapping[str, Setting], narrow: Mapping[str, Setting]
) -> tuple[Variant, ...]:
    """Variants with the study's cameras; then those in which they all look less wide.

    Theirs is the field of view of the study's text, on the VUT, too.
    """
    layout, camera = load_carlancap_layout(), pick_camera("carla-ncap-rgb-90", "variants")
    units = tuple(replace(unit, sensor=camera) for unit in layout.units)
    less_wide = replace(layout, units=units)
    return (
        *(Variant(name=name, setting=one, layout=layout) for name, one in settings.items()),
        *(
            Variant(name=name, setting=replace(one, vut_camera=camera), layout=less_wide)
            for name, one in narrow.items()
        ),
    )


def move_walls(scene: Scene, by_m: float) -> Scene:
    """Every wall moved towards the middle of a junction, by metres along both roads."""
    vertices = scene.vertices_m.copy()
    middle = scene.outline_m.mean(axis=0)
    for index, instance in enumerate(scene.instances):
        if instance.class_name == "wall":
            own = np.unique(scene.triangles[scene.triangle_instance == index])
            nearest = own[np.argmin(np.linalg.norm(vertices[own, :2] - middle, axis=1))]
            vertices[own, :2] -= by_m * np.sign(vertices[nearest, :2] - middle)
    return replace(scene, vertices_m=vertices)


def _keep_parked(setting: Setting, count: int) -> Setting:
    runs = tuple(replace(run, obstruction=run.obstruction[:count]) for run in setting.runs)
    return replace(setting, runs=runs)


def _move_parked(setting: Setting, by_m: float) -> Setting:
    """Parked bodies moved away from the VUT's path, to its right. [m]."""
    runs = []
    for run in setting.runs:
        right = -body_rotation(float(run.vut_yaw_deg[0]))[:, 1]
        bodies = []
        for parked in run.obstruction:
            position_m = parked.pose.position_m + by_m * right
            pose = Pose(position_m=position_m, yaw_deg=parked.pose.yaw_deg)
            bodies.append(PlacedActor(actor=parked.actor, pose=pose))
        runs.append(replace(run, obstruction=tuple(bodies)))
    return replace(setting, runs=tuple(runs))


def _detect_from(setting: Setting, height_px: float) -> Setting:
    default = load_planning_detector()
    assert isinstance(default, GeometricDetector)
    detector = replace(default, min_box_height_px=height_px)
    return replace(setting, detector=detector, table_detector=detector)


ADDITIONAL_CASES = ("CPNCO-50", "CPLA-50", "CBTAno-50", "CBTAfo-50")
TURNING = ("CBTAno-50", "CBTAfo-50")
LARGE_BOX = "smallest box 60 px"
BEFORE = "15 m before the crosswalk"
BEHIND = "cyclist comes from behind"
BEHIND_NARROW = "cyclist comes from behind, field of view 90 deg"
FARTHEST = "met 30 m farther out on the exit arm, no buildings"
SHORTEST = "recordings of the last 0.6 s before the impact"


def build_additional_variants() -> tuple[Variant, ...]:
    """As it is first; some are about some of the cases only."""
    scene = load_study_scene()
    cases = {
        case.name: case for case in select_cases("study").cases if case.name in ADDITIONAL_CASES
    }
    turning = [cases[name] for name in TURNING]
    some = build_setting(replace(AS_STUDIED, cases=TURNING[0]), scene)
    base = _lay(some, cases.values())
    along = [case for case in cases.values() if not is_bound(case)]
    live = replace(base, rule=replace(base.rule, track_memory_s=load_track_memory_s()))
    open_scene = _without(scene, ("building", "wall", "vegetation"))
    behind = _lay(base, [replace(case, vru_direction="same") for case in turning])
    settings = {
        "as it is": base,
        f"a track lives for {live.rule.track_memory_s:g} s": live,
        LARGE_BOX: _detect_from(base, 60.0),
        **{
            f"recordings of the last {last_s:g} s before the impact": _shorten(base, last_s)
            for last_s in (5.0, 3.0, 1.0, 0.6)
        },
        **{
            f"{place_m} m before the crosswalk": _lay(
                base, along, position=read_position(f"-{place_m}", "variants")
            )
            for place_m in (15, 30)
        },
        "cyclist at 20 km/h": _lay(base, [replace(case, vru_speed_kmh=20.0) for case in turning]),
        **{
            f"met at {percent:g} % of the VUT's width": _lay(
                base, [replace(case, impact_percent=percent) for case in turning]
            )
            for percent in (25.0, 75.0)
        },
        **{
            f"met {away_m:g} m farther out on the exit arm, no buildings": _lay(
                replace(base, scene=open_scene), [_farther(case, away_m) for case in turning]
            )
            for away_m in (15.0, 30.0)
        },
        BEHIND: behind,
    }
    return _with_narrow(settings, {_NARROW: base, BEHIND_NARROW: behind})


def _lay(setting: Setting, cases: Iterable[Case], *, position: Position = AT_ZERO) -> Setting:
    """A setting with other cases at all of their speeds, each run alike."""
    runs, _ = build_runs(
        setting.scene,
        cases,
        vut=pick_actor("vut", "variants"),
        rule=setting.rule,
        positions=(position,),
        is_spread=False,
    )
    return _of_runs(setting, runs)


def _farther(case: Case, away_m: float) -> Case:
    """A turning case whose VRU crosses the exit arm so much farther from the junction. [m]."""
    assert case.vru_line is not None
    left_m = case.vru_line.left_m + away_m
    return replace(case, vru_line=replace(case.vru_line, outside_kerb_m=left_m))


def _without(scene: Scene, classes: Sequence[str]) -> Scene:
    """A scene without the things of some classes."""
    kept = [i for i, thing in enumerate(scene.instances) if thing.class_name not in classes]
    number = np.full(len(scene.instances), -1, dtype=scene.triangle_instance.dtype)
    number[kept] = np.arange(len(kept))
    stays = number[scene.triangle_instance] >= 0
    return replace(
        scene,
        triangles=scene.triangles[stays],
        triangle_instance=number[scene.triangle_instance[stays]],
        instances=tuple(scene.instances[i] for i in kept),
    )


def _shorten(setting: Setting, last_s: float) -> Setting:
    """Recordings that begin so long before the impact, if they began earlier. [s]."""
    names = ("time_s", "vut_position_m", "vut_yaw_deg", "vru_position_m", "vru_yaw_deg")
    runs = []
    for run in setting.runs:
        kept = run.time_s >= -last_s - _TOLERANCE_S
        frames = {name: getattr(run, name)[kept] for name in (*names, "vru_shape")}
        runs.append(replace(run, **frames))
    return _of_runs(setting, runs)


_TOLERANCE_S = 1.0e-6


def _of_runs(setting: Setting, runs: Sequence[Run]) -> Setting:
    axis = build_frame_axis(runs, weight_per_run(runs))
    return replace(setting, runs=tuple(runs), axis=axis)
