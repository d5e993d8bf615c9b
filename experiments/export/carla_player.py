"""Drive a run in CARLA, and record it as a folder that ``place-rsus --recording`` reads.

``python FILE --out FOLDER``. Needs numpy, CARLA's Python package (made for 0.9.16) and its server
with the run's map (``--map`` loads one). The server ticks at 10 Hz in synchronous mode; bodies go
from pose to pose, without physics, nobody brakes and walkers do not swing their legs. Boxes are
those of CARLA's pixels; Eval holds what a rule finds in them, to be replaced by a detector's
answers. Frame: x east, y south, z up; metres; yaw clockwise from above, in degrees.
"""

import argparse
import importlib
import math
import queue
import sys
from pathlib import Path
from typing import Any

import numpy as np

SCENARIO: dict[str, Any] = {}  # the export writes it here

_SETTLE_FRAMES = 10  # in which cameras find their exposure
_ABOVE_M = 5.0  # bodies are made in the air: nothing is in the way there
_RED = 2  # of BGRA: the tag of what a pixel shows
_LIMIT_S = 60.0


def transform(carla: Any, place: list[float]) -> Any:
    """CARLA's transform of x, y, z [m], pitch and yaw [degrees]."""
    x_m, y_m, z_m, pitch_deg, yaw_deg = place
    turn = carla.Rotation(pitch=pitch_deg, yaw=yaw_deg, roll=0.0)
    return carla.Transform(carla.Location(x=x_m, y=y_m, z=z_m), turn)


def find_blueprint(library: Any, wanted: dict[str, str]) -> Any:
    """The blueprint of an id, or the first one of an age."""
    if "age" not in wanted:
        return library.find(wanted["id"])
    found = [
        one for one in library.filter(wanted["id"])
        if one.has_attribute("age") and one.get_attribute("age").as_str() == wanted["age"]
    ]  # fmt: skip
    return min(found, key=lambda one: str(one.id))


def stand(carla: Any, body: Any, place: list[float]) -> None:
    """Put a body's box with the middle of its base at a place: origins of actors differ."""
    box, (x_m, y_m, z_m, pitch_deg, yaw_deg) = body.bounding_box, place
    cos, sin = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    x_m -= box.location.x * cos - box.location.y * sin
    y_m -= box.location.x * sin + box.location.y * cos
    z_m += box.extent.z - box.location.z
    body.set_transform(transform(carla, [x_m, y_m, z_m, pitch_deg, yaw_deg]))


def amodal_box(body: Any, camera: Any, size_px: list[int], fov_deg: float) -> list[float] | None:
    """Box of all of a body in the image, clipped to it; None: it is not all ahead of the lens."""
    corners = body.bounding_box.get_world_vertices(body.get_transform())
    world = np.array([[corner.x, corner.y, corner.z, 1.0] for corner in corners])
    ahead, right, up = (world @ np.array(camera.get_transform().get_inverse_matrix()).T)[:, :3].T
    if ahead.min() <= 0.0:
        return None
    width_px, height_px = size_px
    focal_px = 0.5 * width_px / math.tan(math.radians(0.5 * fov_deg))
    columns = np.clip(0.5 * width_px + focal_px * right / ahead, 0.0, width_px)
    rows = np.clip(0.5 * height_px - focal_px * up / ahead, 0.0, height_px)
    return [float(columns.min()), float(rows.min()), float(columns.max()), float(rows.max())]


def visible_box(image: Any, tags: list[int]) -> list[float] | None:
    """Box of the pixels of some tags; None: there are none."""
    pixels = np.frombuffer(image.raw_data, dtype=np.uint8)
    seen = np.isin(pixels.reshape(image.height, image.width, 4)[:, :, _RED], tags)
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    if not len(rows):
        return None
    return [float(columns[0]), float(rows[0]), float(columns[-1] + 1), float(rows[-1] + 1)]


def is_found(visible: list[float], amodal: list[float], rule: dict[str, float]) -> bool:
    """True if so much of a body is seen that the rule counts it."""
    left, top = max(visible[0], amodal[0]), max(visible[1], amodal[1])
    right, bottom = min(visible[2], amodal[2]), min(visible[3], amodal[3])
    both = max(right - left, 0.0) * max(bottom - top, 0.0)
    areas = [(box[2] - box[0]) * (box[3] - box[1]) for box in (visible, amodal)]
    is_high = visible[3] - visible[1] >= rule["min_box_height_px"]
    return is_high and both > rule["min_iou"] * (sum(areas) - both)


class Camera:
    """A unit's pictures, and the tags of their pixels."""

    def __init__(self, carla: Any, world: Any, unit: dict[str, Any]) -> None:
        self.folder, self.places = str(unit["folder"]), unit["places"]
        self.fov_deg = float(unit["attributes"]["fov"])
        self.actors, self.images = [], []
        library = world.get_blueprint_library()
        for kind in ("rgb", "semantic_segmentation"):
            blueprint = library.find(f"sensor.camera.{kind}")
            for name, value in unit["attributes"].items():
                blueprint.set_attribute(name, value)
            actor = world.spawn_actor(blueprint, transform(carla, self.places[0]))
            images: queue.Queue[Any] = queue.Queue()
            actor.listen(images.put)
            self.actors.append(actor)
            self.images.append(images)

    def take(self, tick: int) -> tuple[Any, Any]:
        """Picture and tags of a tick."""
        found = []
        for images in self.images:
            image = images.get(timeout=_LIMIT_S)
            while image.frame < tick:
                image = images.get(timeout=_LIMIT_S)
            found.append(image)
        return found[0], found[1]


def write_frame(
    out: Path, number: int, camera: Camera, images: tuple[Any, Any], met: Any, tags: list[int]
) -> str:
    """Write a unit's label and picture; the line of Eval, if the rule finds the road user."""
    picture, marked = images
    name, kind = f"0_{number}", SCENARIO["met"]["actor_type"]
    picture.save_to_disk(str(out / camera.folder / f"{name}.png"))
    visible, label, found = visible_box(marked, tags), "", ""
    if visible is not None:
        away_m = camera.actors[0].get_location().distance(met.get_location())
        label = f"{kind} {' '.join(map(str, visible))} {away_m}\n"
        amodal = amodal_box(met, camera.actors[0], SCENARIO["size_px"], camera.fov_deg)
        if amodal is not None and is_found(visible, amodal, SCENARIO["rule"]):
            found = f"{camera.folder} {kind} {' '.join(map(str, amodal))} 1.0\n"
    (out / camera.folder / f"{name}.txt").write_text(label)
    return found


def record(carla: Any, world: Any, out: Path) -> None:
    """Drive the run, and write each frame; the server's settings come back afterwards."""
    settings, actors = world.get_settings(), []
    before = settings.synchronous_mode, settings.fixed_delta_seconds
    settings.synchronous_mode = True
    settings.fixed_delta_seconds = 1.0 / SCENARIO["frame_rate_hz"]
    world.apply_settings(settings)
    try:
        bodies = []
        library = world.get_blueprint_library()
        for one in SCENARIO["bodies"]:
            x_m, y_m, z_m, pitch_deg, yaw_deg = one["places"][0]
            above = [x_m, y_m, z_m + _ABOVE_M, pitch_deg, yaw_deg]
            blueprint = find_blueprint(library, one["blueprint"])
            body = world.spawn_actor(blueprint, transform(carla, above))
            actors.append(body)
            body.set_simulate_physics(False)
            bodies.append((body, one["places"]))
        cameras = []
        for unit in SCENARIO["cameras"]:
            cameras.append(Camera(carla, world, unit))
            actors += cameras[-1].actors
        tags = [int(getattr(carla.CityObjectLabel, name)) for name in SCENARIO["met"]["tags"]]
        for folder in (*(camera.folder for camera in cameras), "WorldData", "Eval"):
            (out / folder).mkdir(parents=True)
        (vut, _), (met, _) = bodies[:2]
        speeds = f"{SCENARIO['vut_speed_mps']} {SCENARIO['vru_speed_mps']}"
        for step in range(-_SETTLE_FRAMES, SCENARIO["n_frames"]):
            frame = max(step, 0)
            for body, places in bodies:
                stand(carla, body, places[min(frame, len(places) - 1)])
            for camera in cameras:
                for actor in camera.actors if len(camera.places) > 1 else ():
                    actor.set_transform(transform(carla, camera.places[frame]))
            tick = world.tick(_LIMIT_S)
            taken = [camera.take(tick) for camera in cameras]
            if step < 0:
                continue
            away_m = vut.get_location().distance(met.get_location())
            (out / "WorldData" / f"0_{step}.txt").write_text(f"{away_m} {speeds}")
            found = [
                write_frame(out, step, camera, images, met, tags)
                for camera, images in zip(cameras, taken, strict=True)
            ]
            (out / "Eval" / f"0_{step}.txt").write_text("".join(found))
    finally:
        for actor in reversed(actors):
            actor.destroy()
        settings.synchronous_mode, settings.fixed_delta_seconds = before
        world.apply_settings(settings)


def main() -> None:
    """Read the arguments, and record."""
    parser = argparse.ArgumentParser(description="Drive a run in CARLA, and record it.")
    parser.add_argument("--out", type=Path, required=True, help="New folder of the recording.")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=2000)
    parser.add_argument("--map", help="Map to load first, such as Town05; default: the server's.")
    given = parser.parse_args()
    if given.out.exists() and any(given.out.iterdir()):
        sys.exit(f"{given.out}: got a folder that is not empty; expected a new one")
    carla = importlib.import_module("carla")
    client = carla.Client(given.host, given.port)
    client.set_timeout(_LIMIT_S)
    record(carla, client.load_world(given.map) if given.map else client.get_world(), given.out)


if __name__ == "__main__":
    main()
