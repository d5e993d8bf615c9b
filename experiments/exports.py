"""Layouts and verdicts in the formats of others: CSV, GeoJSON, CARLA, tables."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from geometry.arrays import BoolArray, FloatArray
from geometry.catalogue import Sensor, own_sensor_record
from geometry.errors import InputError, Unquoted
from geometry.frames import to_carla_points, to_carla_yaw, to_geographic
from geometry.lidar import LidarModel
from geometry.maps.local_frame import transform
from geometry.scene import Scene
from placement.candidates import CandidatePose
from placement.evaluation import Evaluation, Verdict, apr
from placement.layout import SCHEMA, Layout, layout_records
from scenarios.runs import FrameAxis

ALL = "all"


def to_csv(layout: Layout, scene: Scene | None = None) -> str:
    """Layout as CSV: one row per unit, in full precision; see :func:`placed_records`."""
    records = placed_records(layout, scene)
    text: str = pd.DataFrame(records).to_csv(index=False, lineterminator="\n")
    return text


def placed_records(layout: Layout, scene: Scene | None) -> list[dict[str, Any]]:
    """Units as records, with their place in the map that a scene was made from.

    Parameters
    ----------
    layout : Layout
        The units.
    scene : Scene or None
        Where they hang; None, or one that was not made from a map: nothing is added.

    Returns
    -------
    records : list of dict
        As :func:`placement.layout.layout_records`; beside these map_x, map_y (longitude and
        latitude where the map has degrees) and map_crs, which is empty if the map does not say
        where on earth it lies.
    """
    records = layout_records(layout)
    if scene is None or not (scene.source_crs or scene.source_origin_m.any()):
        return records
    position = np.array([unit.pose.position_m[:2] for unit in layout.units])
    if scene.crs:
        position = transform(position, scene.crs, scene.source_crs)
    else:
        position = position + scene.source_origin_m
    return [
        record | {"map_x": float(x), "map_y": float(y), "map_crs": scene.source_crs}
        for record, (x, y) in zip(records, position, strict=True)
    ]


def to_json(layout: Layout) -> str:
    """Layout as the JSON file that :func:`placement.layout.load_layout` reads."""
    document = {
        "schema": SCHEMA,
        "name": layout.name,
        "scene": layout.scene_name,
        "layout": layout_records(layout),
    }
    own = {unit.sensor.name: own_sensor_record(unit.sensor) for unit in layout.units}
    sensors = {name: record for name, record in own.items() if record is not None}
    return to_json_text(document | ({"sensors": sensors} if sensors else {}))


def to_geojson(layout: Layout, crs: str, scene: Scene | None = None) -> str:
    """Layout as GeoJSON: points in WGS 84, with the fields of the layout as properties.

    Parameters
    ----------
    layout : Layout
        What to write.
    crs : str
        Coordinate reference system of the world frame, for pyproj.
    scene : Scene, optional
        See :func:`placed_records`.

    Returns
    -------
    text : str
        A FeatureCollection. Coordinates are longitude, latitude [deg] and the height above the
        road [m]; x_m and y_m among the properties stay in the world frame.

    Raises
    ------
    InputError
        pyproj does not know `crs`, or the layout lies outside of where it is defined.

    References
    ----------
    .. [1] RFC 7946, "The GeoJSON Format", sections 3.1.1 (positions) and 4 (WGS 84).
    """
    if not crs:
        raise InputError(
            "geojson", Unquoted("a scene without crs"), "one that says where on earth it lies"
        )
    positions = np.array([unit.pose.position_m for unit in layout.units])
    features = [
        {
            "type": "Feature",
            "id": record["id"],
            "geometry": {
                "type": "Point",
                "coordinates": [float(longitude), float(latitude), record["z_m"]],
            },
            "properties": record,
        }
        for record, (longitude, latitude) in zip(
            placed_records(layout, scene), _longitude_latitude(positions, crs), strict=True
        )
    ]
    return to_json_text({"type": "FeatureCollection", "name": layout.name, "features": features})


def to_carla(layout: Layout) -> str:
    """Layout as a JSON list of cameras to spawn in CARLA.

    Parameters
    ----------
    layout : Layout
        What to write.

    Returns
    -------
    text : str
        Per unit: id, blueprint, its attributes as text (as ``ActorBlueprint.set_attribute`` takes
        them) and the transform. CARLA's left-handed frame, in metres and degrees.
    """
    return to_json_text([_carla_record(unit) for unit in layout.units])


def to_json_text(document: object) -> str:
    r"""JSON of plain values; numbers that JSON lacks (NaN, infinite) become null.

    Examples
    --------
    >>> to_json_text({"gap": math.inf, "apr": 0.1})
    '{\n  "gap": null,\n  "apr": 0.1\n}\n'
    """
    text = json.dumps(_finite(document), indent=2, ensure_ascii=False, allow_nan=False)
    return text + "\n"


FORMATS: Mapping[str, Callable[[Layout, Scene], str]] = {
    "csv": to_csv,
    "geojson": lambda layout, scene: to_geojson(layout, scene.crs, scene),
    "carla": lambda layout, scene: to_carla(layout),
}
"""By name: layout and its scene to text."""


def parties(evaluation: Evaluation) -> dict[str, Verdict]:
    """Every sensing party of an evaluation: "vut", each unit's id, "rsu_all" and so on."""
    return {
        "vut": evaluation.vut,
        **evaluation.units,
        "rsu_all": evaluation.rsu_all,
        "vut_and_rsus": evaluation.vut_and_rsus,
        **evaluation.others,
    }


def margin_s(verdict: Verdict, axis: FrameAxis) -> FloatArray:
    """Last brake time minus (confirmation + latency), per run.

    Parameters
    ----------
    verdict : Verdict
        Whose.
    axis : FrameAxis
        Runs.

    Returns
    -------
    margin_s : (n_runs,) float
        Negative: too late. Minus infinity: never confirmed, or no braking avoids. [s]
    """
    # At most one infinity of each sign: an onset is never -inf, so this is never NaN.
    margin: FloatArray = axis.last_brake_time_s - verdict.onset_time_s
    return margin


def apr_table(evaluations: Mapping[str, Evaluation]) -> pd.DataFrame:
    """Accident prevention ratios of every party, by case, approach and weather.

    Parameters
    ----------
    evaluations : mapping of str to Evaluation
        By the layout's display name.

    Returns
    -------
    table : DataFrame
        Columns layout, party, case, approach, weather, apr, n_runs, n_avoided. "all" stands for
        every case, approach or weather; a single weather has no rows of its own. The ratio is
        missing where none of the runs has weight.
    """
    return pd.DataFrame(
        [
            {
                "layout": name,
                "party": party,
                "case": case,
                "approach": approach,
                "weather": weather,
                "apr": apr(verdict, evaluation.axis, mask),
                "n_runs": int(mask.sum()),
                "n_avoided": int((verdict.is_avoided & mask).sum()),
            }
            for name, evaluation in evaluations.items()
            for party, verdict in parties(evaluation).items()
            for case in (ALL, *dict.fromkeys(evaluation.axis.cases))
            for approach in (ALL, *dict.fromkeys(evaluation.axis.approaches))
            for weather in (ALL, *_several(evaluation.axis.weathers))
            for mask in [_run_mask(evaluation.axis, case, approach, weather)]
            if mask.any()
        ]
    )


def runs_table(evaluations: Mapping[str, Evaluation]) -> pd.DataFrame:
    """Every run's outcome for every party.

    Parameters
    ----------
    evaluations : mapping of str to Evaluation
        By the layout's display name.

    Returns
    -------
    table : DataFrame
        One row per layout, party and run. Times that do not exist (never confirmed, no braking
        avoids) are missing.
    """
    tables = []
    for name, evaluation in evaluations.items():
        axis = evaluation.axis
        for party, verdict in parties(evaluation).items():
            tables.append(
                pd.DataFrame(
                    {
                        "layout": name,
                        "party": party,
                        "run": axis.run_ids,
                        "case": axis.cases,
                        "approach": axis.approaches,
                        "weather": axis.weathers,
                        "vut_speed_kmh": axis.vut_speed_kmh,
                        "weight": axis.weight,
                        "last_brake_time_s": _missing(axis.last_brake_time_s),
                        "confirmation_time_s": _missing(verdict.confirmation_time_s),
                        "margin_s": _missing(margin_s(verdict, axis)),
                        "is_avoided": verdict.is_avoided,
                        "detected_share": np.add.reduceat(verdict.detected, axis.run_start[:-1])
                        / np.diff(axis.run_start),
                    }
                )
            )
    return pd.concat(tables, ignore_index=True)


def _longitude_latitude(positions_m: FloatArray, crs: str) -> FloatArray:
    from pyproj.exceptions import CRSError, ProjError

    try:
        lon_lat_deg = to_geographic(positions_m, crs)
    except (CRSError, ProjError):
        raise InputError("crs", crs, "a coordinate reference system that pyproj knows") from None
    if not np.isfinite(lon_lat_deg).all():
        raise InputError("crs", crs, "a coordinate reference system that contains the layout")
    return lon_lat_deg


def _carla_blueprint(sensor: Sensor) -> dict[str, Any]:
    tick = {"sensor_tick": str(1.0 / sensor.frame_rate_hz)}
    if isinstance(sensor, LidarModel):
        half_deg = 0.5 * sensor.vertical_fov_deg
        return {
            "blueprint": "sensor.lidar.ray_cast",
            "attributes": {
                "channels": str(sensor.n_lines),
                "range": str(sensor.range_m),
                "points_per_second": str(int(sensor.points_per_second)),
                "rotation_frequency": str(sensor.frame_rate_hz),
                "upper_fov": str(half_deg),
                "lower_fov": str(-half_deg),
                "horizontal_fov": str(sensor.horizontal_fov_deg),
                **tick,
            },
        }
    return {
        "blueprint": "sensor.camera.rgb",
        "attributes": {
            "image_size_x": str(sensor.width_px),
            "image_size_y": str(sensor.height_px),
            "fov": str(sensor.horizontal_fov_deg),
            **tick,
        },
    }


def _carla_record(unit: CandidatePose) -> dict[str, Any]:
    pose = unit.pose
    # Adding zero turns -0.0 into 0.0.
    x_m, y_m, z_m = (to_carla_points(pose.position_m) + 0.0).tolist()
    return {
        "id": unit.id,
        **_carla_blueprint(unit.sensor),
        "transform": {
            "location": {"x": x_m, "y": y_m, "z": z_m},
            "rotation": {
                "pitch": pose.pitch_deg,
                "yaw": float(to_carla_yaw(pose.yaw_deg)) + 0.0,
                "roll": 0.0,
            },
        },
    }


def _finite(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, np.generic | np.ndarray):
        return _finite(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _several(words: Sequence[str]) -> tuple[str, ...]:
    """Each word once; none where there is but one."""
    different = tuple(dict.fromkeys(words))
    return different if len(different) > 1 else ()


def _run_mask(axis: FrameAxis, case: str, approach: str, weather: str) -> BoolArray:
    mask: BoolArray = np.ones(axis.n_runs, dtype=bool)
    for wanted, words in (
        (case, axis.cases),
        (approach, axis.approaches),
        (weather, axis.weathers),
    ):
        if wanted != ALL:
            mask &= np.array(words) == wanted
    return mask


def _missing(times_s: FloatArray) -> FloatArray:
    return np.where(np.isfinite(times_s), times_s, np.nan)
