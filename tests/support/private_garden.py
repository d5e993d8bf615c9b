"""Private ground at the study's junction, as GeoJSON."""

import json

import numpy as np
from shapely import box

from geometry.frames import to_geographic
from geometry.study_scene import load_study_scene

PAVEMENT = (-110.0, 10.0, -100.0, 12.0)  # a strip north-east of the junction


def write_garden(folder, sides=PAVEMENT, *, name="garden"):
    """File of a rectangle: lowest and highest east and north. [m]"""
    corners = np.array(box(*sides).exterior.coords)
    ring = to_geographic(corners, load_study_scene().crs).tolist()
    shape = {"type": "Polygon", "coordinates": [ring]}
    feature = {"type": "Feature", "properties": {"name": name}, "geometry": shape}
    path = folder / f"{name}.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    return path
