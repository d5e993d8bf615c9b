"""Layouts as the sensor information of collective perception messages (CPM)."""

import math

import numpy as np

from geometry.actors import load_actors
from geometry.arrays import FloatArray, IntArray
from geometry.errors import InputError, Unquoted
from geometry.frames import parse_crs, to_carla_yaw
from geometry.maps.georeferences import transform
from geometry.scene import Scene
from geometry.sensors import CameraModel
from geometry.terrain import on_ground, terrain_of
from placement.candidates import CandidatePose, is_ring
from placement.detectors import load_detector
from placement.layout import Layout

from .formats import ExportFormat
from .json import to_json_text
from .places import longitude_latitude, require_crs

STANDARD = "ETSI TS 103 324 V2.1.1 with ETSI TS 102 894-2 V2.1.1"
_RSU_CONTAINER, _SENSOR_CONTAINER = 2, 3  # CpmContainerId
_LIDAR, _MONOVIDEO = 2, 3  # SensorType
_PER_DEGREE = 1.0e7  # Latitude, Longitude
_MAX_SENSORS = 128  # SensorInformationContainer
_MAX_RANGE = 4093  # StandardLength12b, in 0.1 m
_MAX_OFFSET = 32766  # CartesianCoordinate, in 0.01 m
_TURN = 3600  # a full turn in 0.1 degrees: a value that is not used
_SEMI_AXIS_UNKNOWN, _HEADING_UNKNOWN, _ALTITUDE_UNKNOWN = 4095, 3601, 800001
_ALTITUDES = -100_000, 800_000  # the first and the last stand for all beyond
_SLACK = 1.0e-6  # of a unit: what rounding may add before it counts as the next one


def to_cpm(layout: Layout, scene: Scene) -> str:
    """Layout as sensor information containers, a station (RSU) per site.

    JSON: {"standard", "stations": [{"site", "units", "payload"}]}. A payload has the standard's
    names and units and what a layout says: the reference position (WGS 84, 0.1 microdegrees; on the
    road in the middle of the station's units; its altitude [0.01 m] where the map counts heights
    from the ellipsoid), the RSU's container and that of its sensors. A sensor's id is its place
    in "units". Its region is a radial shape: reference point east, north, up of the reference
    position [0.01 m], range [0.1 m], horizontal opening clockwise from north and vertical
    opening upwards from the horizon [0.1 degrees]. What a station adds when it sends (reference
    time, confidences) is not in it. Raises InputError if the scene has no crs; a site carries
    more than 128 units, or units too far apart.

    Notes
    -----
    A camera has no range of its own: it ends where an adult is as high in the image as the least
    box of the default detector. Angles are those of the middle of the image's edges; shadowing
    (shadowingApplies) is left to the receiver.

    An altitude is a height above the ellipsoid of WGS 84. Most maps count from the sea: their
    heights would be wrong by up to 100 m, and the grid that turns one into the other is seldom at
    hand. Then the altitude is unavailable.

    Of a LiDAR that scans all round the horizontal opening starts at 0 (north) and ends at 359.9
    degrees. A full turn has no value of its own: 360.0 means "not used", and a start that equals
    the end reads as no opening as well as a full one. So a tenth of a degree is left out, to the
    north, and every receiver that takes the way from start to end has all but that. If the LiDAR is
    tilted, the vertical opening is what it reaches to any side, not to each.

    References
    ----------
    .. [1] ETSI TS 103 324 V2.1.1, SensorInformationContainer; ETSI TS 102 894-2 V2.1.1, SensorType,
       RadialShape, CartesianPosition3d, Wgs84AngleValue, CartesianAngleValue.
    """
    require_crs(scene.crs, "cpm")
    stations: dict[tuple[str, str], list[CandidatePose]] = {}
    for unit in layout.units:
        key = (unit.site_id, "") if unit.site_id else ("", unit.id)
        stations.setdefault(key, []).append(unit)
    middles_m = np.array(
        [
            np.mean([unit.pose.position_m[:2] for unit in units], axis=0)
            for units in stations.values()
        ]
    )
    lon_lat = np.round(longitude_latitude(middles_m, scene.crs) * _PER_DEGREE).astype(int)
    # Offsets count from the rounded position, or they would be a centimetre off.
    origins_m = transform(lon_lat / _PER_DEGREE, "EPSG:4326", scene.crs)
    adult_px_m = load_actors()["adult"].height_m / load_detector().min_box_height_px
    records = []
    for ((site, own), units), reference, origin_m in zip(
        stations.items(), lon_lat, origins_m, strict=True
    ):
        where = f"cpm: {site or own}"
        if len(units) > _MAX_SENSORS:
            raise InputError(where, Unquoted(f"{len(units)} units"), f"at most {_MAX_SENSORS}")
        road_m = on_ground(origin_m, terrain_of(scene))
        shapes = [_radial_shape(unit, road_m, adult_px_m, where) for unit in units]
        payload = _payload(units, shapes, reference, _altitude_cm(scene, float(road_m[2])))
        records.append({"site": site, "units": [unit.id for unit in units], "payload": payload})
    return to_json_text({"standard": STANDARD, "stations": records})


def _payload(
    units: list[CandidatePose],
    shapes: list[dict[str, object]],
    lon_lat: IntArray,
    altitude_cm: int,
) -> dict[str, object]:
    return {
        "managementContainer": {
            "referencePosition": {
                "latitude": int(lon_lat[1]),
                "longitude": int(lon_lat[0]),
                "positionConfidenceEllipse": {
                    "semiMajorConfidence": _SEMI_AXIS_UNKNOWN,
                    "semiMinorConfidence": _SEMI_AXIS_UNKNOWN,
                    "semiMajorOrientation": _HEADING_UNKNOWN,
                },
                "altitude": {
                    "altitudeValue": altitude_cm,
                    "altitudeConfidence": "unavailable",
                },
            }
        },
        "cpmContainers": [
            {"containerId": _RSU_CONTAINER, "containerData": {}},
            {
                "containerId": _SENSOR_CONTAINER,
                "containerData": [
                    {
                        "sensorId": index,
                        "sensorType": _MONOVIDEO
                        if isinstance(unit.sensor, CameraModel)
                        else _LIDAR,
                        "perceptionRegionShape": {"radial": shape},
                        "shadowingApplies": True,
                    }
                    for index, (unit, shape) in enumerate(zip(units, shapes, strict=True))
                ],
            },
        ],
    }


def _altitude_cm(scene: Scene, height_m: float) -> int:
    """Height above the ellipsoid of what is some metres above the scene's zero."""
    crs = parse_crs(scene.source_crs) if scene.source_crs else None
    is_ellipsoidal = crs is not None and len(crs.axis_info) == 3 and not crs.is_compound
    if scene.zero_height_m is None or not is_ellipsoidal:
        return _ALTITUDE_UNKNOWN
    value = round(100.0 * (scene.zero_height_m + height_m))
    low, high = _ALTITUDES
    return min(max(value, low), high)


def _radial_shape(
    unit: CandidatePose, origin_m: FloatArray, adult_px_m: float, where: str
) -> dict[str, object]:
    offset = np.round((unit.pose.position_m - origin_m) * 100.0).astype(int)
    if np.abs(offset).max() > _MAX_OFFSET:
        raise InputError(
            where,
            Unquoted(f"{unit.id} {np.abs(offset).max() / 100.0:g} m from the site's other units"),
            f"at most {_MAX_OFFSET / 100.0:g} m",
        )
    half_deg = 0.5 * unit.sensor.horizontal_fov_deg
    half_vertical_deg = 0.5 * unit.sensor.vertical_fov_deg
    lowest_deg, highest_deg = unit.pose.pitch_deg, unit.pose.pitch_deg
    heading_deg = float(to_carla_yaw(unit.pose.yaw_deg)) + 90.0
    start, end = _tenths(heading_deg - half_deg) % _TURN, _tenths(heading_deg + half_deg) % _TURN
    if is_ring(unit.sensor):
        start, end = 0, _TURN - 1
        # Tilted, its front goes down by as much as its back goes up.
        lowest_deg, highest_deg = -abs(unit.pose.pitch_deg), abs(unit.pose.pitch_deg)
    # What looks straight down sees beyond it, but there is no steeper direction.
    low_deg = max(lowest_deg - half_vertical_deg, -90.0)
    high_deg = min(highest_deg + half_vertical_deg, 90.0)
    return {
        "shapeReferencePoint": {
            "xCoordinate": int(offset[0]),
            "yCoordinate": int(offset[1]),
            "zCoordinate": int(offset[2]),
        },
        "range": min(_tenths(_range_m(unit, adult_px_m)), _MAX_RANGE),
        "stationaryHorizontalOpeningAngleStart": start,
        "stationaryHorizontalOpeningAngleEnd": end,
        "verticalOpeningAngleStart": _tenths(low_deg) % _TURN,
        "verticalOpeningAngleEnd": _tenths(high_deg) % _TURN,
    }


def _range_m(unit: CandidatePose, adult_px_m: float) -> float:
    if not isinstance(unit.sensor, CameraModel):
        return unit.sensor.range_m
    return unit.sensor.focal_length_px * adult_px_m


def _tenths(value: float) -> int:
    """Tenths as the standard counts them: n is more than n - 1 and at most n of them."""
    return math.ceil(10.0 * value - _SLACK)


FORMAT = ExportFormat(
    write=to_cpm,
    content="sensor information per site, ETSI TS 103 324 as JSON; V2X stacks",
    needs_crs=True,
)
