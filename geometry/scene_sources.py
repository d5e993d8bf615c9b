"""Scenes from wherever they are: the study's junction, a saved scene, or a map.

What reads each of them is looked up in a registry, so that who loads a scene depends
on no format of maps.
"""

import zipfile
from pathlib import Path
from typing import Protocol

from .opening import open_file
from .registry import load_entry
from .scene import Scene

STUDY = "town05"
"""Name of the study's junction."""
SCENE_FILE = "scene.toml"

_MAP_READER = "geometry.maps.importing:load_map_scene"
STREETS = (".osm", ".pbf")
FOOTPRINTS = (".geojson", ".gpkg", ".shp")
MESHES = (".glb", ".gltf", ".obj", ".ply", ".stl")
CLOUDS = (".las", ".laz")
MAP_SUFFIXES = (
    *(".xodr", *STREETS, *FOOTPRINTS, ".json", ".gml", ".citygml", ".xml"),
    *(*MESHES, *CLOUDS, ".zip"),
)
READERS = {
    "study": "geometry.study_scene:read_study_scene",
    "saved": "geometry.scene_files:read_saved_scene",
    **dict.fromkeys(MAP_SUFFIXES, _MAP_READER),
}
"""Registry of the readers of scenes, by the kind of the source; of maps by suffix.

Each is a :class:`SceneReader`.
"""


class SceneReader(Protocol):
    """What makes a scene out of a source."""

    def __call__(
        self,
        path: Path,
        *,
        junction: str,
        at: tuple[float, float] | None,
        sites: str,
        sites_crs: str,
        keeps_left: bool | None,
    ) -> Scene:
        """Read a scene; only maps have use for the options, see :func:`load_scene`.

        Raises InputError if the source cannot be read.
        """


def load_scene(
    source: str | Path = "",
    *,
    junction: str = "",
    at: tuple[float, float] | None = None,
    sites: str = "auto",
    sites_crs: str = "",
    keeps_left: bool | None = None,
) -> Scene:
    """Load the scene of a junction from wherever it is.

    `source`: nothing or "town05" is the junction of the CarlaNCAP study; a folder
    or .zip file that :func:`geometry.scene_files.save_scene` has written; or a map with
    roads, such as "city.osm" or "city.xodr", of which one junction is cut out. Of a
    map, `junction` is an id, streets or "latitude,longitude", or `at` a point within
    100 m in the map's own coordinates; by default the one with the most arms and lanes.
    `sites` and `sites_crs`: see :class:`geometry.maps.importing.ImportOptions`.
    `keeps_left`: by default what the map says.

    Raises
    ------
    InputError
        There is no scene and no map, or it cannot be read.

    Examples
    --------
    >>> load_scene()
    Scene('town05', 1266 triangles, 41 instances, 28 sites)
    """
    path = Path(source)
    read: SceneReader = load_entry(READERS[_kind_of(source)])
    return read(
        path,
        junction=junction,
        at=at,
        sites=sites,
        sites_crs=sites_crs,
        keeps_left=keeps_left,
    )


def _kind_of(source: str | Path) -> str:
    """Key of a source in the registry; what is no map is taken for a saved scene."""
    path = Path(source)
    if not str(source) or (str(source) == STUDY and not path.exists()):
        return "study"
    if path.is_file() and not has_scene(path):
        name = path.name.lower()
        for suffix in MAP_SUFFIXES:
            if name.endswith(suffix):
                return suffix
    return "saved"


def has_scene(path: Path) -> bool:
    """True if a path is a folder, or the archive of a scene.

    A damaged archive counts. Maps may be .zip, too.
    """
    if path.is_dir():
        return True
    if path.suffix.lower() != ".zip" or not path.exists():
        return False
    try:
        with open_file(path) as file, zipfile.ZipFile(file) as packed:
            return SCENE_FILE in packed.namelist()
    except (OSError, zipfile.BadZipFile):
        return True
