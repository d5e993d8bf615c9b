"""Stands in for CARLA's server: its client's names, bodies that are boxes, pictures of their tags.

As a module in place of ``carla`` it brings its own values; run as a program beside CARLA's package,
``python carla_server.py SCRIPT OUT``, it takes that package's values and checks that each name that
it offers is there, too: nothing else of the package works without a server.
"""

import json
import math
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import ClassVar

import numpy as np


class Vector3D:
    def __init__(self, x=0.0, y=0.0, z=0.0):
        self.x, self.y, self.z = float(x), float(y), float(z)


class Location(Vector3D):
    def distance(self, other):
        return math.dist((self.x, self.y, self.z), (other.x, other.y, other.z))


class Rotation:
    def __init__(self, pitch=0.0, yaw=0.0, roll=0.0):
        self.pitch, self.yaw, self.roll = float(pitch), float(yaw), float(roll)


class Transform:
    """Axes as in CARLA's ``Transform.h``: x ahead, y right, z up."""

    def __init__(self, location, rotation):
        self.location, self.rotation = location, rotation

    def get_matrix(self):
        turn = self.rotation
        angles = np.radians([turn.yaw, turn.pitch, turn.roll])
        (cy, cp, cr), (sy, sp, sr) = np.cos(angles), np.sin(angles)
        return [
            [cp * cy, cy * sp * sr - sy * cr, -cy * sp * cr - sy * sr, self.location.x],
            [cp * sy, sy * sp * sr + cy * cr, -sy * sp * cr + cy * sr, self.location.y],
            [sp, -cp * sr, cp * cr, self.location.z],
            [0.0, 0.0, 0.0, 1.0],
        ]

    def get_inverse_matrix(self):
        return np.linalg.inv(self.get_matrix()).tolist()


class BoundingBox:
    def __init__(self, location, extent):
        self.location, self.extent = location, extent

    def get_world_vertices(self, transform):
        sides = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
        middle, extent = self.location, self.extent
        local = [
            [middle.x + x * extent.x, middle.y + y * extent.y, middle.z + z * extent.z, 1.0]
            for x, y, z in sides
        ]
        return [Location(*row[:3]) for row in np.array(local) @ np.array(transform.get_matrix()).T]


class CityObjectLabel:  # 0.9.16
    Pedestrians, Rider, Bicycle = 12, 13, 19


VALUES = ("Vector3D", "Location", "Rotation", "Transform", "BoundingBox", "CityObjectLabel")

# By blueprint: middle of the box from the actor's origin, half its size, its pixels' tag.
BOXES = {
    "vehicle.lincoln.mkz_2020": ((0.04, 0.0, 0.72), (2.446, 0.918, 0.755), 14),
    "vehicle.diamondback.century": ((0.1, 0.0, 0.85), (0.82, 0.25, 0.9), 13),
    "walker.pedestrian.0005": ((0.0, 0.0, 0.0), (0.25, 0.3, 0.93), 12),
    "walker.pedestrian.0048": ((0.0, 0.0, 0.0), (0.2, 0.2, 0.6), 12),
}
OTHER = ((0.0, 0.0, 0.7), (2.1, 0.9, 0.75), 14)
AGES = {"walker.pedestrian.0005": "adult", "walker.pedestrian.0048": "child"}


class ActorBlueprint:
    def __init__(self, name):
        self.id, self.given = name, {}

    def set_attribute(self, name, value):
        assert isinstance(value, str), (name, value)
        self.given[name] = value

    def has_attribute(self, name):
        return name == "age" and self.id in AGES

    def get_attribute(self, _name):
        return SimpleNamespace(as_str=lambda: AGES[self.id])


class BlueprintLibrary:
    def find(self, name):
        return ActorBlueprint(name)

    def filter(self, pattern):
        assert pattern == "walker.pedestrian.*"
        return [ActorBlueprint(name) for name in sorted(AGES, reverse=True)]


class Actor:
    def __init__(self, world, blueprint, transform):
        self.world, self.blueprint, self.transform = world, blueprint, transform
        self.listener, self.has_physics = None, True
        self.middle, self.extent, self.tag = BOXES.get(blueprint.id, OTHER)
        self.bounding_box = world.carla.BoundingBox(
            world.carla.Location(*self.middle), world.carla.Vector3D(*self.extent)
        )

    def set_simulate_physics(self, enabled):
        self.has_physics = enabled

    def set_transform(self, transform):
        self.transform = transform

    def get_transform(self):
        return self.transform

    def get_location(self):
        return self.transform.location

    def listen(self, callback):
        self.listener = callback

    def destroy(self):
        self.world.actors.remove(self)


class Image:
    def __init__(self, frame, pixels):
        self.frame, self.raw_data = frame, pixels.tobytes()
        self.height, self.width = pixels.shape[:2]

    def save_to_disk(self, path):
        Path(path).write_bytes(b"picture")


class World:
    def __init__(self, carla):
        self.carla, self.actors, self.frame, self.log = carla, [], 100, []
        self.settings = SimpleNamespace(synchronous_mode=False, fixed_delta_seconds=None)

    def get_settings(self):
        return self.settings

    def apply_settings(self, settings):
        self.log.append((settings.synchronous_mode, settings.fixed_delta_seconds))

    def get_blueprint_library(self):
        return BlueprintLibrary()

    def spawn_actor(self, blueprint, transform):
        self.actors.append(Actor(self, blueprint, transform))
        return self.actors[-1]

    def tick(self, seconds):
        assert seconds > 0.0
        self.frame += 1
        bodies = [one for one in self.actors if one.listener is None]
        assert not any(body.has_physics for body in bodies)
        for camera in self.actors:
            if camera.listener is not None:
                camera.listener(Image(self.frame - 1, np.zeros((1, 1, 4), np.uint8)))  # a late one
                camera.listener(Image(self.frame, self.draw(camera, bodies)))
        return self.frame

    def draw(self, camera, bodies):
        """Tags of the boxes around bodies, the farthest first; a picture is left black."""
        given = camera.blueprint.given
        width, height = int(given["image_size_x"]), int(given["image_size_y"])
        pixels = np.zeros((height, width, 4), np.uint8)
        if "semantic" not in camera.blueprint.id:
            return pixels
        focal = 0.5 * width / math.tan(math.radians(0.5 * float(given["fov"])))
        inverse = np.array(camera.transform.get_inverse_matrix())
        boxes = []
        for body in bodies:
            corners = body.bounding_box.get_world_vertices(body.transform)
            local = np.array([[one.x, one.y, one.z, 1.0] for one in corners]) @ inverse.T
            if local[:, 0].min() > 0.0:
                columns = 0.5 * width + focal * local[:, 1] / local[:, 0]
                rows = 0.5 * height - focal * local[:, 2] / local[:, 0]
                boxes.append((local[:, 0].mean(), columns, rows, body.tag))
        for _, columns, rows, tag in sorted(boxes, key=lambda box: -box[0]):
            left, top = (max(math.floor(side.min()), 0) for side in (columns, rows))
            right, bottom = (max(math.ceil(side.max()), 0) for side in (columns, rows))
            pixels[top:bottom, left:right, 2] = tag
        return pixels


class Client:
    worlds: ClassVar = []  # that were handed out

    def __init__(self, host="127.0.0.1", port=2000):
        assert (host, port) == ("127.0.0.1", 2000)

    def set_timeout(self, seconds):
        assert seconds > 0.0

    def get_world(self):
        Client.worlds.append(World(sys.modules["carla"]))
        return Client.worlds[-1]

    def load_world(self, name):
        assert name == "Town05"
        return self.get_world()


def as_module():
    """A module that stands in for the package."""
    module = ModuleType("carla")
    for name in (*VALUES, "Client"):
        setattr(module, name, globals()[name])
    return module


def missing_names(carla):
    """What this server offers and CARLA's package lacks."""
    own = {
        "Client": Client, "World": World, "Actor": Actor, "Image": Image,
        "ActorBlueprint": ActorBlueprint, "BlueprintLibrary": BlueprintLibrary,
        **{name: globals()[name] for name in VALUES},
    }  # fmt: skip
    fields = {
        "Actor": ["bounding_box"], "Image": ["frame", "raw_data", "height", "width"],
        "ActorBlueprint": ["id"], "ActorAttribute": ["as_str"], "Sensor": ["listen"],
        "WorldSettings": ["synchronous_mode", "fixed_delta_seconds"],
        "BoundingBox": ["location", "extent"], "Transform": ["location", "rotation"],
    }  # fmt: skip
    inner = {"World.draw", "Client.worlds", "Actor.listen"}
    wanted = {
        f"{kind}.{name}" for kind, one in own.items() for name in vars(one) if name[0] != "_"
    } | {f"{kind}.{name}" for kind, names in fields.items() for name in names}
    missing = []
    for dotted in sorted(wanted - inner):
        kind, name = dotted.split(".")
        if not hasattr(getattr(carla, kind, None), name):
            missing.append(dotted)
    return missing


def main():
    script, out = sys.argv[1:]
    import carla

    missing = missing_names(carla)
    tags = {name: int(getattr(carla.CityObjectLabel, name)) for name in vars(CityObjectLabel)
            if name[0].isupper()}  # fmt: skip
    place = carla.Transform(carla.Location(1, 2, 3), carla.Rotation(pitch=10, yaw=20, roll=30))
    own = Transform(Location(1, 2, 3), Rotation(pitch=10, yaw=20, roll=30))
    off = float(np.abs(np.array(place.get_matrix()) - own.get_matrix()).max())
    carla.Client = Client
    sys.argv = [script, "--out", out]
    runpy.run_path(script, run_name="__main__")
    answer = {"missing": missing, "tags": tags, "off": off, "log": Client.worlds[0].log}
    sys.stdout.write(json.dumps(answer))


if __name__ == "__main__":
    main()
