"""The CarlaNCAP study: its setting and its layout of 12 cameras."""

from functools import cache
from importlib.resources import files

from geometry.arrays import float_array
from geometry.catalogue import pick_camera
from geometry.files import (
    load_toml,
    take_list,
    take_number,
    take_text,
)
from geometry.frames import from_carla_pose
from geometry.scene import Scene
from geometry.study_scene import load_study_scene
from placement import planning
from placement.candidates import CandidatePose
from placement.layout import Layout


@cache
def load_carlancap_layout() -> Layout:
    """The study's 12 roadside cameras, from ``data/carla_ncap_layout.toml``."""
    where = "carla_ncap_layout.toml"
    table = load_toml(files("experiments") / "data" / where)
    camera = pick_camera(take_text(table, "camera", where), f"{where}: camera")
    units = []
    for index, entry in enumerate(take_list(table, "units", where)):
        here = f"{where}: units[{index}]"
        units.append(
            CandidatePose(
                id=take_text(entry, "id", here),
                site_id=take_text(entry, "site", here),
                pose=from_carla_pose(
                    position_m=float_array(
                        take_list(entry, "position_m", here), (3,), f"{here}.position_m"
                    ),
                    yaw_deg=take_number(entry, "yaw_deg", here),
                    pitch_deg=take_number(entry, "pitch_deg", here),
                ),
                sensor=camera,
            )
        )
    return Layout(
        name=take_text(table, "name", where),
        units=tuple(units),
        scene_name=load_study_scene().name,
    )


def find_baseline(scene: Scene) -> Layout | None:
    """What layouts of a scene are compared with: the study's, or at another junction nothing."""
    study = load_carlancap_layout()
    return study if scene.name == study.scene_name else None


def find_layout(name: str, option: str, *, scene: Scene | None = None, sensors: str = "") -> Layout:
    """A layout from a file, or the study's by its name; see :mod:`placement.planning`."""
    study = load_carlancap_layout()
    return planning.find_layout(name, option, study=study, scene=scene, sensors=sensors)
