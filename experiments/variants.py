"""The study's setting with one thing of our reconstruction changed: what the figures hang on."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from geometry.actors import PlacedActor
from geometry.catalogue import pick_camera
from geometry.poses import Pose, body_rotation
from geometry.scene import Scene
from geometry.scene_files import load_study_scene
from placement.detectors import GeometricDetector, load_planning_detector
from placement.driving import build_setting
from placement.layout import Layout
from placement.question import Question
from placement.setting import Setting
from scenarios.runs import Run

from .study import load_carlancap_layout

OWN_CASES = "CPNC-50,CBNA,CBLA"
"""The cases whose starts and figures the study publishes."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Variant:
    """A setting and the study's layout in it.

    Attributes
    ----------
    name : str
        What is changed.
    setting : Setting
        Scene, runs, detector.
    layout : Layout
        The study's 12 cameras.
    """

    name: str
    setting: Setting
    layout: Layout


def build_variants() -> tuple[Variant, ...]:
    """As it is first; then walls, parked cars, smallest box, field of view and phase, changed."""
    layout = load_carlancap_layout()
    base = build_setting(Question(cases=OWN_CASES), load_study_scene())
    changes: Mapping[str, Callable[[], Setting]] = {
        "as it is": lambda: base,
        "walls 0.5 m nearer to the corner": lambda: _move_walls(base, 0.5),
        "walls 5 m farther from the corner": lambda: _move_walls(base, -5.0),
        "no parked cars": lambda: _keep_parked(base, 0),
        "no parked cars, walls 5 m farther": lambda: _move_walls(_keep_parked(base, 0), -5.0),
        "two parked cars instead of eight": lambda: _keep_parked(base, 2),
        "parked row 1 m beside the VUT, not 0.5 m": lambda: _move_parked(base, 0.5),
        "smallest box 30 px": lambda: _detect_from(base, 30.0),
        "smallest box 50 px": lambda: _detect_from(base, 50.0),
        "worst phase of the frames": lambda: build_setting(
            Question(cases=OWN_CASES, phase="worst"), base.scene
        ),
    }
    variants = [
        Variant(name=name, setting=build(), layout=layout) for name, build in changes.items()
    ]
    narrow = pick_camera("carla-ncap-rgb-90", "variants")
    return (
        *variants,
        Variant(
            name="field of view 90 deg, not 110",
            setting=replace(base, vut_camera=narrow),
            layout=replace(
                layout, units=tuple(replace(unit, sensor=narrow) for unit in layout.units)
            ),
        ),
    )


def _move_walls(setting: Setting, by_m: float) -> Setting:
    """Every wall moved towards the middle of the junction, along both roads. [m]."""
    return replace(setting, scene=move_walls(setting.scene, by_m))


def move_walls(scene: Scene, by_m: float) -> Scene:
    """Move every wall towards the middle of a junction.

    Parameters
    ----------
    scene : Scene
        The junction.
    by_m : float
        East or west, and as much north or south. [m]

    Returns
    -------
    scene : Scene
        All else stands where it stood.
    """
    vertices = scene.vertices_m.copy()
    middle = scene.outline_m.mean(axis=0)
    for index, instance in enumerate(scene.instances):
        if instance.class_name == "wall":
            own = np.unique(scene.triangles[scene.triangle_instance == index])
            nearest = own[np.argmin(np.linalg.norm(vertices[own, :2] - middle, axis=1))]
            vertices[own, :2] -= by_m * np.sign(vertices[nearest, :2] - middle)
    return replace(scene, vertices_m=vertices)


def _keep_parked(setting: Setting, count: int) -> Setting:
    return _with_runs(setting, lambda run: run.obstruction[:count])


def _move_parked(setting: Setting, by_m: float) -> Setting:
    """Parked bodies moved away from the VUT's path, to its right. [m]."""

    def moved(run: Run) -> tuple[PlacedActor, ...]:
        right = -body_rotation(float(run.vut_yaw_deg[0]))[:, 1]
        return tuple(
            PlacedActor(
                actor=parked.actor,
                pose=Pose(
                    position_m=parked.pose.position_m + by_m * right,
                    yaw_deg=parked.pose.yaw_deg,
                ),
            )
            for parked in run.obstruction
        )

    return _with_runs(setting, moved)


def _with_runs(setting: Setting, obstruction: Callable[[Run], tuple[PlacedActor, ...]]) -> Setting:
    runs = tuple(replace(run, obstruction=obstruction(run)) for run in setting.runs)
    return replace(setting, runs=runs)


def _detect_from(setting: Setting, height_px: float) -> Setting:
    default = load_planning_detector()
    assert isinstance(default, GeometricDetector)
    detector = replace(default, min_box_height_px=height_px)
    return replace(setting, detector=detector, planner=detector)
