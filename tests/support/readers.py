"""Every reader of files that users give, with small sound files: what the fuzz tests
damage.

A new reader is covered by being registered here; test_fuzz.py fails if one is not.
"""

import io
import json
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from importlib.resources import files as shipped
from pathlib import Path
from typing import Any

import numpy as np
from box_faces import BOX_FACES

Files = Mapping[str, bytes]  # by name, in a folder
Seeds = Mapping[str, tuple[str, Files]]  # by kind: what is read, and all files

TOML_FOLDER = Path(__file__).parents[2] / "docs/files"


@dataclass(frozen=True)
class Reader:
    """A function that reads what a user gives, and what it can be given."""

    # Sound files by what they are, each alone in a folder but for those that belong to
    # it; the first name is what is read, "." stands for the folder.
    seeds: Callable[[], Seeds]
    covers: tuple[str, ...]  # functions behind it, by module and name
    read: Callable[[Path], Any] | None = None  # the first of `covers` if not said
    takes: type = Path  # what that function takes
    share: int = 1  # of the time: about as many as it has formats

    def __post_init__(self):
        if self.read is None:
            object.__setattr__(self, "read", self._read_by_first)

    def _read_by_first(self, path):
        module, _, name = self.covers[0].rpartition(".")
        return getattr(import_module(module), name)(self.takes(path))


def _written(write: Callable[[Path], object]) -> Files:
    """The files that a function writes into an empty folder."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder))
        return {
            path.relative_to(folder).as_posix(): path.read_bytes()
            for path in sorted(Path(folder).rglob("*"))
            if path.is_file()
        }


def _one(name: str, data: bytes | str) -> tuple[str, Files]:
    """A file alone in a folder."""
    return name, {name: data.encode() if isinstance(data, str) else data}


# ---------- maps


def _osm() -> str:
    """A crossing with a building, a lamp, a crossing on foot and a wall."""
    from osm_text import OsmText, crossing

    osm = OsmText()
    crossing(
        osm,
        bearings=[
            (1, 0),
            (0, 1),
            (-1, 0),
            (0, -1),
        ],
        lanes="2",
        maxspeed="50",
        width="7",
    )
    osm.way(
        [
            (20.0, 20.0),
            (40.0, 20.0),
            (40.0, 30.0),
            (20.0, 20.0),
        ],
        {"building": "yes"},
    )
    osm.node(8.0, 8.0, highway="street_lamp", height="6 m")
    osm.node(12.0, 0.0, highway="crossing")
    osm.way(
        [(9.0, -30.0), (9.0, -60.0)],
        {"barrier": "wall", "height": "2"},
    )
    osm.way(
        [
            (-20.0, 20.0),
            (-40.0, 20.0),
            (-40.0, 30.0),
            (-20.0, 20.0),
        ],
        {"building:part": "yes"},
    )
    return osm.text()


def _pbf() -> bytes:
    """The same, packed."""
    import osmium

    def write(folder: Path) -> None:
        (folder / "a.osm").write_text(_osm())
        with osmium.SimpleWriter(folder / "b.osm.pbf") as writer:
            for element in osmium.FileProcessor(folder / "a.osm"):
                writer.add(element)
        (folder / "a.osm").unlink()

    return _written(write)["b.osm.pbf"]


def _xodr() -> str:
    """A crossing with objects, signals and a road of its own."""
    from opendrive_text import crossing, document, road

    objects = (
        '<object id="1" type="building" s="20" t="12" zOffset="0" hdg="0" length="8"'
        ' width="6" height="5"/><object id="2" type="pole" s="10" t="6" height="6"'
        ' radius="0.1"><outline><cornerLocal u="1" v="0" z="0" height="2"/><cornerLocal'
        ' u="0" v="1" z="0" height="2"/><cornerLocal u="-1" v="0" z="0"'
        ' height="2"/></outline></object>'
    )
    signals = (
        '<signal id="3" s="15" t="5" zOffset="4" type="1000001" dynamic="yes"'
        ' height="1"/>'
    )
    extra = road(
        "77",
        objects=objects,
        signals=signals,
        offset='<laneOffset s="0" a="1" b="0" c="0" d="0"/>',
    )
    header = "<geoReference><![CDATA[+proj=utm +zone=33 +datum=WGS84]]></geoReference>"
    return document(crossing(), extra, header=header)


def _geojson(*shapes, **properties):
    """Text of features with the same properties."""
    features = [
        {"type": "Feature", "properties": properties, "geometry": shape}
        for shape in shapes
    ]
    return json.dumps({"type": "FeatureCollection", "features": features})


def _features() -> dict[str, Any]:
    """Two footprints in GeoJSON."""
    ring = [
        [13.36, 52.5],
        [13.3601, 52.5],
        [13.3601, 52.5001],
        [13.36, 52.5001],
        [13.36, 52.5],
    ]
    return {
        "type": "FeatureCollection",
        "features": [
            {
                "type": "Feature",
                "properties": {
                    "id": "a",
                    "height": 6.0,
                    "levels": 2,
                    "class": "building",
                },
                "geometry": {"type": "Polygon", "coordinates": [ring]},
            },
            {
                "type": "Feature",
                "properties": {"id": "b"},
                "geometry": {"type": "MultiPolygon", "coordinates": [[ring]]},
            },
        ],
    }


def _features_as(driver: str, name: str) -> Files:
    """Two footprints in a format of GDAL."""
    import geopandas
    from shapely.geometry import box

    def write(folder: Path) -> None:
        shapes = [box(390_000, 5_819_000, 390_010, 5_819_008), box(0, 0, 1, 1)]
        frame = geopandas.GeoDataFrame(
            {"height": [6.0, 2.5]}, geometry=shapes, crs="EPSG:25833"
        )
        frame.to_file(folder / name, driver=driver)

    return _written(write)


def _zipped(files: Files) -> bytes:
    """Files in an archive."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return packed.getvalue()


_CORNERS = [[x, y, z] for x in (0, 6) for y in (0, 8) for z in (0, 5)]


def _city_json() -> dict[str, Any]:
    """A house of two parts, and a tree."""
    surfaces = [[face] for face in BOX_FACES]
    solid = {"type": "Solid", "lod": "2", "boundaries": [surfaces]}
    flat = {"type": "MultiSurface", "lod": "1.2", "boundaries": surfaces[:2]}
    return {
        "type": "CityJSON",
        "version": "2.0",
        "transform": {"scale": [1.0] * 3, "translate": [390_000.0, 5_819_000.0, 30.0]},
        "metadata": {"referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/25833"},
        "CityObjects": {
            "a": {"type": "Building", "geometry": [solid], "children": ["b"]},
            "b": {"type": "BuildingPart", "geometry": [flat], "parents": ["a"]},
            "c": {"type": "SolitaryVegetationObject", "geometry": [flat]},
        },
        "vertices": _CORNERS,
    }


def _city_gml() -> str:
    """A house."""
    places = [f"{x + 390_000} {y + 5_819_000} {z}" for x, y, z in _CORNERS]
    rings = ""
    for face in BOX_FACES:
        corners = " ".join(places[i] for i in [*face, face[0]])
        rings += (
            "<gml:surfaceMember><gml:Polygon><gml:exterior><gml:LinearRing>"
            f"<gml:posList>{corners}</gml:posList></gml:LinearRing></gml:exterior>"
            "</gml:Polygon></gml:surfaceMember>"
        )
    return (
        '<CityModel xmlns="http://www.opengis.net/citygml/2.0" '
        'xmlns:bldg="http://www.opengis.net/citygml/building/2.0" '
        'xmlns:gml="http://www.opengis.net/gml"'
        ' xmlns:xlink="http://www.w3.org/1999/xlink">'
        "<gml:boundedBy><gml:Envelope"
        ' srsName="urn:ogc:def:crs:EPSG::25833"><gml:lowerCorner>'
        "0 0 0</gml:lowerCorner></gml:Envelope></gml:boundedBy>"
        '<cityObjectMember><bldg:Building gml:id="a"><bldg:measuredHeight uom="m">5'
        "</bldg:measuredHeight><bldg:lod2Solid><gml:Solid><gml:exterior><gml:CompositeSurface>"
        f"{rings}</gml:CompositeSurface></gml:exterior></gml:Solid></bldg:lod2Solid>"
        "</bldg:Building></cityObjectMember></CityModel>"
    )


def _mesh(suffix: str) -> Files:
    """A house and a tree in a format of meshes."""
    import trimesh

    def write(folder: Path) -> None:
        scene = trimesh.Scene()
        for index, name in enumerate(("House_1", "Tree.003")):
            solid = trimesh.creation.box((4.0, 5.0, 6.0))
            solid.apply_translation([10.0 * index, 0.0, 3.0])
            scene.add_geometry(solid, node_name=name, geom_name=name)

        if suffix in ("glb", "gltf", "obj"):
            whole = scene
        else:
            whole = scene.to_geometry()
        whole.export(folder / f"a.{suffix}")

    return _written(write)


def _points(suffix: str) -> bytes:
    """A house on the ground as a cloud of 2,600 points."""
    import laspy
    import trimesh

    solid = trimesh.creation.box((6.0, 4.0, 5.0))
    solid.apply_translation([0.0, 0.0, 2.5])
    rng = np.random.default_rng(1)
    ground = np.column_stack([rng.uniform(-8, 8, (600, 2)), np.zeros(600)])
    points = np.concatenate([solid.sample(2000, seed=1), ground])
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = [0.001] * 3
    header.offsets = [390_000.0, 5_819_000.0, 35.0]
    las = laspy.LasData(header)
    las.x, las.y, las.z = (points + header.offsets).T
    las.classification = np.repeat([6, 2], [2000, 600]).astype(np.uint8)
    return _written(lambda folder: las.write(folder / f"a.{suffix}"))[f"a.{suffix}"]


def _streets() -> Seeds:
    """Maps of roads."""
    from lanelet_text import commonroad, crossing, lanelet2

    text = _osm().encode()
    return {
        "osm": _one("a.osm", text),
        "pbf": _one("a.osm.pbf", _pbf()),
        "opendrive": _one("a.xodr", _xodr()),
        "lanelet2": _one("a.osm", lanelet2(crossing())),
        "commonroad": _one("a.xml", commonroad(crossing())),
    }


def _things() -> Seeds:
    """Maps of buildings and other things."""
    shapes = _features_as("ESRI Shapefile", "a.shp")
    return {
        "geojson": _one("a.geojson", json.dumps(_features())),
        "geopackage": ("a.gpkg", _features_as("GPKG", "a.gpkg")),
        "shapefile": ("a.shp", shapes),
        "shapefile.zip": _one("a.zip", _zipped(shapes)),
        "cityjson": _one("a.city.json", json.dumps(_city_json())),
        "citygml": _one("a.gml", _city_gml()),
        **{
            suffix: (f"a.{suffix}", _mesh(suffix))
            for suffix in ("glb", "gltf", "obj", "ply", "stl")
        },
        **{suffix: _one(f"a.{suffix}", _points(suffix)) for suffix in ("las", "laz")},
    }


def _read_street_map(path: Path) -> Any:
    from geometry.maps.importing import ImportOptions, import_scene

    return import_scene([path], ImportOptions())


def _read_things(path: Path) -> Any:
    from geometry.maps.importing import ReadingOptions, read_map

    return read_map(path, ReadingOptions(unit="m", up="z"))


def _sites() -> Seeds:
    """Lists of places for sensors."""
    point = {"type": "Point", "coordinates": [13.38, 52.51, 35.0]}
    return {
        "csv": _one(
            "a.csv",
            "ID;X_m;Y_m;Z;Min_Height_m;max_height;Kind;Cost_EUR;Power;fibre;Capacity;Forbidden\n"
            "a;390000;5819000;35.5;4;8;Lamp_Post;2500;yes;no;2;no\nb;390010.5;5819000;;;;;;;;;YES\n",
        ),
        "degrees": _one("a.csv", "id,latitude_deg,Longitude\na,52.51,13.38\n"),
        "geojson": _one("a.geojson", _geojson(point, id=7, cost_eur=10)),
    }


def _read_sites(path: Path) -> Any:
    from geometry.maps.place_lists import read_sites

    return read_sites(path, crs="EPSG:25833")


def _places() -> Seeds:
    """Lists and areas with weights of junctions."""
    square = [
        [13.37, 52.5],
        [13.39, 52.5],
        [13.39, 52.52],
        [13.37, 52.52],
        [13.37, 52.5],
    ]
    shapes = {
        "point": {"type": "Point", "coordinates": [13.38, 52.51]},
        "area": {"type": "Polygon", "coordinates": [square]},
    }
    return {
        "degrees": _one("a.csv", "lat,lon,count\n52.51,13.38,3\n"),
        "junctions": _one("a.csv", "junction,weight\nA Street / B Street,2.5\n"),
    } | {
        kind: _one("a.geojson", _geojson(shape, min_apr=0.5))
        for kind, shape in shapes.items()
    }


def _read_places(path: Path) -> Any:
    from geometry.maps.place_lists import read_areas, read_counts

    if b"Polygon" in path.read_bytes():
        return read_areas(path, crs="EPSG:25833")
    return read_counts(path, crs="EPSG:25833")


def _city_folder() -> Seeds:
    """What a city's folder says of its junctions."""
    import msgspec

    from experiments.city.answer import CityEntry, CityFrontRecord, CityManifest
    from experiments.city.inputs import CityMapRecord
    from placement.city.fronts import NOTHING, JunctionFront

    manifest = CityManifest(
        maps=(CityMapRecord(name="a.osm", sha256="0", has_roads=True),),
        crs="EPSG:25833",
        bounds=(0.0, 0.0, 1.0, 1.0),
        junctions=(
            CityEntry(
                id="1",
                map="a.osm",
                folder="1",
                key="0",
                sha256="0",
            ),
        ),
    )
    front = CityFrontRecord(
        **dict.fromkeys(("key", "id", "name", "map", "scene", "reason"), "1"),
        **dict.fromkeys(("sites", "poses", "runs", "frames"), 1),
        front=JunctionFront(
            points=(replace(NOTHING, apr=0.5),),
            by_units=((0.0, 0.5),),
            by_cost=((0.0, 0.5),),
        ),
        layouts=((),),
        seconds={"table": 1.0},
        peak_memory_mib=1.0,
    )
    return {
        name: _one(f"{name}.json", msgspec.json.encode(record))
        for name, record in (
            ("manifest", manifest),
            ("front", front),
        )
    }


def _read_city_folder(path: Path) -> Any:
    from experiments.city.answer import load_front, load_manifest

    if path.name == "manifest.json":
        return load_manifest(path)
    return load_front(path)  # None where it is damaged: it is made anew


# ---------- scenes


@cache
def _small_scene() -> Any:
    """A junction with a wall."""
    from junctions import protocol_scene

    return protocol_scene(boxes=[("wall", 20.0, 20.0, 8.0, 1.0, 3.0)])


def _scenes() -> Seeds:
    """A scene as a folder and as an archive."""
    from geometry.notes import Note
    from geometry.scene_files import save_scene

    scene = replace(
        _small_scene(),
        notes=(
            Note(
                what="a",
                why="b",
                kind="sites",
                site_ids=("c",),
            ),
        ),
    )
    files = _written(lambda folder: save_scene(folder, scene))
    return {"folder": (".", files), "zip": _one("a.zip", _zipped(files))}


def _box_scene() -> Seeds:
    return {
        "toml": _one("a.toml", (shipped("geometry") / "data/town05.toml").read_bytes())
    }


# ---------- what is asked


def _example(name: str) -> tuple[str, Files]:
    """A file of the documentation."""
    return _one("a.toml", (TOML_FOLDER / name).read_bytes())


def _sensors() -> Seeds:
    """Catalogues of cameras and of LiDARs."""
    lidars = (shipped("geometry") / "data/lidars.toml").read_text()
    table = lidars[lidars.index("[lidars.carla-ncap-lidar]") :]
    lidar = table.split("\n\n")[0].replace(".carla-ncap-lidar]", ".mine]")
    return {"cameras": _example("cameras.toml"), "lidars": _one("a.toml", lidar)}


def _own_cases() -> Seeds:
    """A case like one of ours, and a recorded one."""
    text = """
    [SCHOOL]
    as = "CPNA-25"
    title = "a child runs across"
    vru = "child"
    vut_speed_kmh = { min = 30, max = 40, step = 10 }

    [NEAR]
    kind = "recorded"
    title = "a pedestrian"
    source = "a.csv"
    vru = "adult"
    vut_speed_kmh = 30.0
    vru_speed_kmh = 5.0
    known_s = 3.0
    vut_way = { points_m = [[0.0, 0.0], [10.0, 0.0]], yaw_deg = 0.0, end_s = -1.0 }
    vru_way = { points_m = [[20.0, -5.0], [20.0, -1.5]], yaw_deg = 90.0, end_s = -1.0 }
    """
    return {"toml": _one("a.toml", text)}


def _read_trajectories(path: Path) -> Any:
    from scenarios.conflicts import find_encounters
    from scenarios.trajectories import read_tracks

    tracks, _ = read_tracks(path)
    return find_encounters(tracks[:6], ttc_s=2.0)


def _trajectories() -> Seeds:
    """A car and a pedestrian who come near each other."""
    rows = [
        f"{name},{0.1 * step:.1f},"
        f"{x + 0.1 * step * u},{y + 0.1 * step * v},{heading},{word}"
        for name, x, y, u, v, heading, word in (
            ("a", 0.0, 0.0, 8.0, 0.0, 0.0, "car"),
            ("b", 30.0, -6.0, 0.0, 1.4, 90.0, "pedestrian"),
        )
        for step in range(25)
    ]
    header = "id,time,x,y,heading,class"
    things = [
        f'<timestep time="{0.1 * step:.1f}"><vehicle id="a" x="{0.8 * step}" y="0"'
        f' angle="90" type="car"/><person id="b" x="30" y="{0.14 * step - 6.0}"'
        ' angle="0"/></timestep>'
        for step in range(25)
    ]
    return {
        "csv": _one("a.csv", "\n".join([header, *rows])),
        "fcd": _one("a.xml", f"<fcd-export>{''.join(things)}</fcd-export>"),
    }


def _read_layout_list(path: Path) -> Any:
    from geometry.study_scene import load_study_scene
    from placement.layout import load_layout

    scene = replace(load_study_scene(), crs="EPSG:32633", source_crs="EPSG:4326")
    return load_layout(path, scene=scene)


def _layout_lists() -> Seeds:
    """A layout as a list of cameras."""
    head = "Name;Latitude;Longitude;Height [m];Bearing;Tilt;Model"
    row = "C1;0,0000798;10,5102222;6,5;135;20;carla-ncap-rgb"
    return {"csv": _one("a.csv", f"{head}\n{row}\n")}


def _latencies() -> Seeds:
    return {"parts": _example("latency.toml")}


def _decision_rules() -> Seeds:
    text = (shipped("scenarios") / "data/decision.toml").read_text()
    return {"built in": _one("decision.toml", text)}


def _uncertainties() -> Seeds:
    """Each uncertainty by its name, and that of the documentation."""
    text = (shipped("placement") / "data/uncertainty.toml").read_text()
    shared = text.index('[aimed."by eye"]')
    rest = text.index("[robustness]")
    text = text[:shared] + text[rest:]  # no section of any of the names
    names = ("default", "robustness", "as-measured")
    starts = [text.index(f"[{name}") for name in (*names, "none")]
    files_of = {"example": _example("uncertainty.toml")}
    for name, start, end in zip(names, starts, starts[1:], strict=False):
        table = text[start:end].replace(f"[{name}]\n", "").replace(f"[{name}.", "[")
        files_of[name] = _one("a.toml", table)
    return files_of


def _detectors() -> Seeds:
    table = shipped("placement.detectors") / "data/detectors.toml"
    return {"response": _one("a.toml", table.read_bytes())}


def _layouts() -> Seeds:
    """A layout of two cameras and a LiDAR."""
    place = {
        "x_m": 1.0,
        "y_m": 2.0,
        "z_m": 5.0,
        "yaw_deg": 90.0,
        "pitch_deg": -20.0,
    }
    mine = {
        "kind": "camera",
        "width_px": 640,
        "height_px": 480,
        "horizontal_fov_deg": 60.0,
        "frame_rate_hz": 10.0,
        "near_m": 0.5,
        "price_eur": 100.0,
        "fov_range_deg": [30.0, 90.0],
    }
    units = [
        {
            "id": "U1",
            "site": "a",
            **place,
            "camera": "carla-ncap-rgb",
            "latency_s": 0.1,
        },
        {"id": "U2", **place, "lidar": "carla-ncap-lidar"},
        {
            "id": "U3",
            **place,
            "camera": "mine",
            "fov_deg": 45.0,
        },
    ]
    layout = {
        "name": "a",
        "scene": "town05",
        "layout": units,
        "sensors": {"mine": mine},
    }
    return {"json": _one("a.json", json.dumps(layout))}


@cache
def _small_runs() -> Any:
    """Four runs of the study."""
    from geometry.actors import load_actors
    from geometry.study_scene import load_study_scene
    from scenarios.aeb import load_aeb_rule
    from scenarios.cases import pick_cases
    from scenarios.runs import build_runs

    cases = pick_cases("CPNC-50", "cases")
    runs, _ = build_runs(
        load_study_scene(), cases, vut=load_actors()["vut"], rule=load_aeb_rule()
    )
    return runs[:4]


def _read_weights(path: Path) -> Any:
    from scenarios.weight_tables import weight_from_csv

    return weight_from_csv(path, _small_runs())


def _weights() -> Seeds:
    """Weights by case and approach."""
    rows = "CPNC-50,*,2,day\n"
    return {
        "commas": _one("a.csv", "case,approach,weight,weather\n" + rows),
        "semicolons": _one(
            "a.csv", f"case;approach;weight\nCPNC-50;{_small_runs()[0].approach};1\n"
        ),
    }


def _read_accidents(path: Path) -> Any:
    from scenarios.accidents import read_accidents
    from scenarios.weights import STATS19, UNFALLATLAS

    return read_accidents(STATS19 if "collision" in path.name else UNFALLATLAS, path)


def _accidents() -> Seeds:
    """Two accidents of the German atlas, and one of the British statistics."""
    atlas = (
        "UJAHR;UART;UTYP1;ULICHTVERH;IstRad;IstPKW;IstFuss;IstKrad;XGCSWGS84;YGCSWGS84\n"
        "2023;6;4;0;0;1;1;0;13,405;52,52\n2023;5;3;2;1;1;0;0;13,406;52,521\n"
    )
    vehicles = (
        "collision_index,vehicle_reference,vehicle_type,vehicle_manoeuvre,vehicle_direction_to\n"
        "1,1,9,18,1\n1,2,1,18,3\n"
    )
    casualties = (
        "collision_index,vehicle_reference,casualty_class,pedestrian_movement\n"
        "1,2,1,0\n"
    )
    return {
        "unfallatlas": _one("a.csv", b"\xef\xbb\xbf" + atlas.encode()),
        "stats19": (
            "collision.csv",
            {
                "collision.csv": (
                    b"collision_index,longitude,latitude,light_conditions\n"
                    b"1,-0.12,51.5,1\n"
                ),
                "vehicle.csv": vehicles.encode(),
                "casualty.csv": casualties.encode(),
            },
        ),
    }


def _read_private_ground(path: Path) -> Any:
    from geometry.study_scene import load_study_scene
    from placement.private_ground import load_private_ground

    return load_private_ground(path, load_study_scene())


def _private_ground() -> Seeds:
    """A garden at the study's junction."""
    from pyproj import Transformer

    from geometry.study_scene import load_study_scene

    crs = load_study_scene().crs
    to_degrees = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    ring = [
        [-120.0, 0.0],
        [-110.0, 0.0],
        [-110.0, 10.0],
        [-120.0, 0.0],
    ]
    corners = [list(to_degrees.transform(*point)) for point in ring]
    garden = {"type": "Polygon", "coordinates": [corners]}
    return {"geojson": _one("a.geojson", _geojson(garden, name="garden"))}


# ---------- recordings


def _read_recording(path: Path) -> Any:
    from placement.recordings import evaluate_recording, read_recording
    from scenarios.aeb import load_aeb_rule

    return evaluate_recording(read_recording(path), load_aeb_rule(), min_confidence=0.5)


def _recordings() -> Seeds:
    """A drive of 42 frames in which a unit and the car label a pedestrian."""
    files: dict[str, bytes] = {}
    for index in range(42):
        before = max(0, 11 - index)
        name = f"3_{index}.txt"
        files[f"WorldData/{name}"] = f"{2.0 + before!r} 10.0 1.5".encode()
        line = "pedestrian 100 200 140 300"
        files |= {f"{unit}/{name}": f"{line} 20.0\n".encode() for unit in ("0", "car")}
        if 7 <= before <= 10:
            files[f"Eval/{name}"] = f"0 {line} 0.9\n".encode()
        else:
            files[f"Eval/{name}"] = b""

    return {"one drive": (".", files)}


def _read_boxes(path: Path) -> Any:
    from placement.recordings.formats import (
        WILDTRACK,
        find_format,
        read_boxes,
        read_wildtrack,
    )

    if find_format(path) == WILDTRACK:
        return read_wildtrack(path)
    return read_boxes(path)


_CVML = (
    "<dataset>"
    + "".join(
        f'<frame number="{frame}"><objectlist><object id="1">'
        f'<box h="80" w="30" xc="{100 + frame}" yc="90"/></object></objectlist></frame>'
        for frame in range(3)
    )
    + "</dataset>"
)
_KITTI = (
    "0 -1 DontCare -1 -1 -10 219 188 245 218 -1000 -1000 -1000 -10 -1 -1 -1\n"
    "0 2 Pedestrian 0 1 -2.5 1106.1 166.5 1204.4 323.8 1.7 0.7 0.9 6.3 1.6 8.4 -1.9\n"
    "1 2 Pedestrian 0 3 -2.5 1106.1 166.5 1204.4 323.8 1.7 0.7 0.9 6.3 1.6 8.4 -1.9\n"
)


def _many_boxes() -> Seeds:
    """Boxes in each format of recordings."""
    person = {"personID": 1, "positionID": 456826, "views": []}
    for view in range(7):
        if view:
            sides = (10, 20, 30, 40)
        else:
            sides = (-1, -1, -1, -1)
        names = ("xmin", "ymin", "xmax", "ymax")
        person["views"] += [{"viewNum": view} | dict(zip(names, sides, strict=True))]

    frame = json.dumps([person]).encode()
    return {
        "cvml": _one("a.xml", _CVML),
        "mot gt": _one("a.txt", "1,1,10,20,30,40,1,1,0.5\n2,1,11,20,30,40,0,1,0.5\n"),
        "mot det": _one(
            "a.txt", "1,-1,10,20,30,40,0.9,-1,-1,-1\n1,-1,0,0,3,4,0.1,-1,-1,-1\n"
        ),
        "kitti": _one("a.txt", _KITTI),
        "rrc": _one("a.txt", "0,107.7,198.4,161.2,291.5,0.73\n4,1,2,3,4,0.5\n"),
        "pointrcnn": _one(
            "a.txt", "0,3,753,160,927,374,6.1,1.7,0.6,1.8,1.6,1.6,5.7,-1.7,-1.9\n"
        ),
        "wildtrack": (".", {f"{number:08d}.json": frame for number in (0, 5, 10)}),
    }


_TSAI = (
    '<Camera><Geometry width="768" height="576" dpx="5e-3" dpy="4.6e-3"/><Intrinsic'
    ' focal="5.5" kappa1="5e-3" cx="324" cy="282" sx="1.09"/><Extrinsic tx="828"'
    ' ty="-3175" tz="35469" rx="2.04" ry="-0.89" rz="-0.43"/></Camera>'
)
_INTRINSIC = (
    "<opencv_storage><camera_matrix><data>1743 0 934 0 1735 444 0 0"
    " 1</data></camera_matrix><distortion_coefficients><data>-0.4 0.6 0.008 0.001"
    " -0.6</data></distortion_coefficients></opencv_storage>"
)
_EXTRINSIC = (
    "<opencv_storage><rvec>1.7 0.4 -0.3</rvec><tvec>-525 45 986</tvec></opencv_storage>"
)


_MATRIX = (
    "camera_matrix: {tag}{rows: 3, cols: 3, data: [900, 0, 640, 0, 880, 360, 0, 0, 1]}"
)
_ROS = (
    "image_width: 1280\nimage_height: 720\ncamera_name: a\n"
    + _MATRIX.replace("{tag}", "")
    + "\ndistortion_model: equidistant\ndistortion_coefficients: {data: [0.1, 0, 0,"
    " 0.01]}\nstatic_transform:\n  transform:\n    translation: {x: 1, y: 2, z: 6}\n "
    "   rotation: {x: 0, y: 0.6, z: 0, w: 0.8}\n"
)
_FILE_STORAGE = (
    '%YAML:1.0\n---\ncameras:\n  - id: "a"\n    image_width: 1280\n    image_height:'
    " 720\n    "
    + _MATRIX.replace("{tag}", "!!opencv-matrix ")
    + "\n    distortion_coefficients: !!opencv-matrix {data: [0.1, 0, 0, 0, 0]}\n"
    "    R: !!opencv-matrix {data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}\n"
    "    t: !!opencv-matrix {data: [0, 0, 6]}\n"
)


def _read_calibration(path: Path) -> Any:
    """Cameras of a file; of a pair of files, what they say together."""
    from geometry.calibrations import read_cameras, read_opencv_camera

    if path.name == "intrinsic.xml":
        read_opencv_camera(path, path.with_name("extrinsic.xml"), (1242, 375))
    return read_cameras(path, size_px=(1242, 375))


def _calibrations() -> Seeds:
    """Calibrations in each format."""
    pair = {"intrinsic.xml": _INTRINSIC.encode(), "extrinsic.xml": _EXTRINSIC.encode()}
    return {
        "tsai": _one("tsai.xml", _TSAI),
        "opencv": ("intrinsic.xml", pair),
        "kitti": _one(
            "calib.txt", "P0: 1\nP2: 721.5 0 609.5 44.8 0 721.5 172.8 0.2 0 0 1 0.003\n"
        ),
        "ros": _one("ros.yaml", _ROS),
        "filestorage": _one("cameras.yaml", _FILE_STORAGE),
    }


# ---------- problems, and what commands have written


@cache
def _certified() -> Files:
    """A small problem and its certificate."""
    from certified import document_of, two_of_twelve
    from tiny_worlds import three_runs

    from placement.optimiser import solve_placement
    from placement.proof_files import save_certificate
    from scenarios.aeb import load_aeb_rule

    problem = two_of_twelve(three_runs(), load_aeb_rule())
    document = document_of(problem, solve_placement(problem))
    return _written(lambda folder: save_certificate(folder, document, problem))


@cache
def _results() -> Files:
    """A folder of results."""
    from small_results import build_small_setting, write_small_results

    return _written(lambda folder: write_small_results(folder, build_small_setting()))


def _result_folders() -> Seeds:
    return {"placement": (".", _results())}


def _read_result(path: Path) -> Any:
    from experiments.parts.reading import load_result
    from experiments.results.folders import changed_files

    changed_files(path)
    return load_result(path)


def _read_verified(path: Path) -> Any:
    from experiments.jobs.verify import run_verification
    from experiments.progress import StageProgress

    return run_verification(path, progress=StageProgress())


@cache
def _table() -> tuple[Any, Any]:
    """Units and runs of a detection table."""
    from placement.layout import load_carlancap_layout
    from scenarios.runs import build_frame_axis
    from scenarios.weights import weight_per_run

    runs = _small_runs()
    axis = build_frame_axis(runs, weight_per_run(runs))
    return load_carlancap_layout().units, axis


_FINGERPRINT = "0123456789abcdef" * 2


def _tables() -> Seeds:
    """A cached table in which nothing is detected."""
    from placement.detection_table import DetectionTable
    from placement.visibility import save_table

    units, axis = _table()
    packed = np.zeros((len(units), -(-axis.n_frames // 8)), dtype=np.uint8)
    ids = tuple(unit.id for unit in units)
    table = DetectionTable(pose_ids=ids, axis=axis, packed=packed)

    def write(folder):
        save_table(folder / "a.npz", table, fingerprint=_FINGERPRINT)

    return {"npz": ("a.npz", _written(write))}


def _read_table(path: Path) -> Any:
    from placement.visibility import load_table

    units, axis = _table()
    return load_table(path, fingerprint=_FINGERPRINT, candidates=units, axis=axis)


def _demands() -> Seeds:
    import placement

    source = Path(placement.__path__[0]) / "data/demand.toml"
    return {"default": _one("a.toml", source.read_bytes().decode())}


def _manifests() -> Seeds:
    """Manifest of a dataset with one unit and one drive."""
    from msgspec import json

    from experiments.perception_lab.dataset import (
        MANIFEST,
        DatasetDrive,
        DatasetRecord,
        DatasetUnit,
    )

    rows = (
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 1.0),
    )
    unit = DatasetUnit(
        folder="0",
        id="U1",
        width_px=4,
        height_px=3,
        camera_matrix=rows,
        world_to_camera=rows,
        translation_m=(0.0, 0.0, 0.0),
    )
    drive = DatasetDrive(
        run="CBLA/east/40",
        weather="day",
        scenario=0,
        first_number=0,
        frames=9,
        last_brake_time_s=None,
    )
    record = DatasetRecord(
        schema="place-rsus/dataset/1",
        format="coco",
        scene="town05",
        detector="geometric",
        every=1,
        lidar="none",
        masks=False,
        depth=False,
        vehicles=False,
        vary=False,
        seed=0,
        units=(unit,),
        drives=(drive,),
    )
    return {"manifest": _one(MANIFEST, json.encode(record))}


_CORNER_M = (400_000.0, 5_800_000.0)


def _rasters() -> Seeds:
    """Heights of 80 by 80 metres."""
    import rasterio

    def write(folder: Path) -> None:
        with rasterio.open(
            folder / "a.tif",
            "w",
            driver="GTiff",
            **{
                "height": 40,
                "width": 40,
                "count": 1,
                "dtype": "float32",
                "nodata": -9999.0,
            },
            crs="EPSG:32633",
            transform=rasterio.Affine(
                2.0, 0.0, _CORNER_M[0] - 40, 0.0, -2.0, _CORNER_M[1] + 40
            ),
        ) as raster:
            raster.write(
                np.linspace(0.0, 5.0, 1600, dtype=np.float32).reshape(40, 40), 1
            )

    return {"GeoTIFF": _one("a.tif", _written(write)["a.tif"])}


def _read_raster(path: Path) -> Any:
    from geometry.maps.relief import read_elevation

    return read_elevation(
        path, crs="EPSG:32633", middle_m=np.array(_CORNER_M), half_m=30.0
    )


READERS: Mapping[str, Reader] = {
    "heights": Reader(
        read=_read_raster,
        seeds=_rasters,
        covers=("geometry.maps.relief.read_elevation",),
    ),
    "datasets": Reader(
        _manifests,
        ("experiments.perception_lab.dataset.load_manifest",),
    ),
    "demand": Reader(_demands, ("placement.sampling.moving.demand.load_demand",)),
    "street maps": Reader(
        read=_read_street_map,
        seeds=_streets,
        covers=(
            "geometry.maps.importing.import_scene",
            "geometry.maps.importing.read_maps",
            "geometry.maps.opendrive.read_opendrive",
            "geometry.maps.lanelets.read_lanelet2",
            "geometry.maps.lanelets.read_commonroad",
            "geometry.maps.openstreetmap.read_openstreetmap",
            "geometry.maps.openstreetmap.elements.read_elements",
            "geometry.maps.openstreetmap.elements.read_loose_elements",
            "geometry.xml_files.read_xml",
            "geometry.xml_files.read_xml_children",
            "geometry.xml_files.read_xml_root",
        ),
        share=4,
    ),
    "things": Reader(
        read=_read_things,
        seeds=_things,
        covers=(
            "geometry.maps.importing.read_map",
            "geometry.maps.importing.load_map_scene",
            "geometry.maps.gis_files.read_features",
            "geometry.maps.gis_files.read_footprints",
            "geometry.maps.city_models.read_cityjson",
            "geometry.maps.city_models.read_citygml",
            "geometry.maps.mesh_files.read_mesh",
            "geometry.maps.point_clouds.read_point_cloud",
            "geometry.maps.point_clouds.open_points",
            "geometry.opening.read_text",
        ),
        share=8,
    ),
    "sites": Reader(
        read=_read_sites,
        seeds=_sites,
        covers=(
            "geometry.maps.place_lists.read_sites",
            "geometry.maps.place_lists.read_csv_rows",
            "geometry.maps.place_lists.read_site_rows",
            "geometry.csv_files.read_csv_text",
        ),
    ),
    "places of a city": Reader(
        read=_read_places,
        seeds=_places,
        covers=(
            "geometry.maps.place_lists.read_counts",
            "geometry.maps.place_lists.read_areas",
        ),
    ),
    "folder of a city": Reader(
        read=_read_city_folder,
        seeds=_city_folder,
        covers=(
            "experiments.city.answer.load_manifest",
            "experiments.city.answer.load_front",
        ),
    ),
    "scenes": Reader(
        seeds=_scenes,
        covers=(
            "geometry.scene_sources.load_scene",
            "geometry.scene_files.read_saved_scene",
            "geometry.scene_files.load_scene_folder",
        ),
    ),
    "scenes of boxes": Reader(_box_scene, ("geometry.study_scene.load_box_scene",)),
    "sensors": Reader(
        _sensors,
        ("geometry.catalogue.load_catalogue", "geometry.text_formats.load_toml"),
    ),
    "question": Reader(
        lambda: {"example": _example("question.toml")},
        ("placement.question.load_question", "placement.question.load_question_values"),
    ),
    "own cases": Reader(_own_cases, ("scenarios.cases.load_own_cases",)),
    "trajectories": Reader(
        read=_read_trajectories,
        seeds=_trajectories,
        covers=("scenarios.trajectories.read_tracks",),
    ),
    "layout lists": Reader(
        read=_read_layout_list,
        seeds=_layout_lists,
        covers=("placement.foreign_layouts.read_layout_rows",),
    ),
    "latency budget": Reader(
        _latencies, ("placement.latency.load_latency_budget",), takes=str
    ),
    "decision rule": Reader(
        _decision_rules, ("scenarios.decision.load_decision_rule",), takes=str
    ),
    "uncertainty": Reader(
        _uncertainties, ("placement.sampling.uncertainty.load_uncertainty",), takes=str
    ),
    "detector": Reader(
        _detectors,
        (
            "placement.detectors.registry.load_detector",
            "placement.detectors.response.load_response_file",
        ),
        takes=str,
    ),
    "layout": Reader(
        _layouts,
        (
            "placement.layout.load_layout",
            "placement.layout.find_layout",
            "placement.foreign_layouts.read_list",
            "placement.foreign_layouts.read_calibrations",
        ),
    ),
    "weights": Reader(
        read=_read_weights,
        seeds=_weights,
        covers=("scenarios.weight_tables.weight_from_csv",),
    ),
    "accidents": Reader(
        read=_read_accidents,
        seeds=_accidents,
        covers=("scenarios.accidents.read_accidents",),
    ),
    "no-look areas": Reader(
        read=_read_private_ground,
        seeds=_private_ground,
        covers=(
            "placement.private_ground.load_private_ground",
            "placement.forbidden_views.load_forbidden_areas",
        ),
    ),
    "recordings": Reader(
        read=_read_recording,
        seeds=_recordings,
        covers=(
            "placement.recordings.read.read_recording",
            "placement.recordings.files.read_labels",
            "placement.recordings.files.read_detections",
            "placement.recordings.files.read_world",
        ),
    ),
    "recorded boxes": Reader(
        read=_read_boxes,
        seeds=_many_boxes,
        covers=(
            "placement.recordings.formats.find_format",
            "placement.recordings.formats.read_boxes",
            "placement.recordings.files.read_lines",
            "placement.recordings.formats.read_wildtrack",
        ),
        share=3,
    ),
    "recorded calibrations": Reader(
        read=_read_calibration,
        seeds=_calibrations,
        covers=(
            "geometry.calibrations.read_cameras",
            "geometry.calibrations.read_tsai",
            "geometry.calibrations.read_kitti_camera",
            "geometry.calibrations.read_opencv_camera",
        ),
        share=2,
    ),
    "placement problems": Reader(
        seeds=lambda: {"npz": _one("instance.npz", _certified()["instance.npz"])},
        covers=(
            "placement.verification.instances.load_problem",
            "placement.verification.instances.load_stored_problem",
        ),
    ),
    "certificates": Reader(
        seeds=lambda: {
            "json": _one("certificate.json", _certified()["certificate.json"])
        },
        covers=("placement.verification.certificates.load_certificate",),
    ),
    "results": Reader(
        read=_read_result,
        seeds=_result_folders,
        covers=(
            "experiments.parts.reading.load_result",
            "experiments.parts.reading.read_summary",
            "experiments.results.folders.read_manifest",
            "experiments.results.folders.changed_files",
        ),
    ),
    "results to verify": Reader(
        read=_read_verified,
        seeds=_result_folders,
        covers=("experiments.jobs.verify.run_verification",),
    ),
    "cached tables": Reader(
        read=_read_table,
        seeds=_tables,
        covers=("placement.visibility.build.load_table", "placement.cache.load_arrays"),
    ),
}
