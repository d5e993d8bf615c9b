"""Layouts as the JSON file that place-rsus reads.

And JSON of plain values.
"""

import json

from geometry.catalogue import own_sensor_record
from geometry.notes import assumed_sites
from geometry.scene import Scene
from placement.layout import SCHEMA, Layout, layout_records

from ..results.record import to_plain
from . import ExportFormat


def to_json_text(document: object) -> str:
    r"""JSON of values and records.

    Numbers that JSON lacks (NaN, infinite) become null.

    Examples
    --------
    >>> to_json_text({"gap": float("inf"), "apr": 0.1})
    '{\n  "gap": null,\n  "apr": 0.1\n}\n'
    """
    text = json.dumps(to_plain(document), indent=2, ensure_ascii=False)
    return text + "\n"


def to_json(layout: Layout, scene: Scene | None = None) -> str:
    """Layout as the JSON file that ``--layout`` reads.

    With a scene, what is assumed of sites.
    """
    doubts = {} if scene is None else assumed_sites(scene.notes)
    units = [
        record
        | ({"assumed": doubts[record["site"]]} if record["site"] in doubts else {})
        for record in layout_records(layout)
    ]
    document = {
        "schema": SCHEMA,
        "name": layout.name,
        "scene": layout.scene_name,
        "layout": units,
    }
    own = {unit.sensor.name: own_sensor_record(unit.sensor) for unit in layout.units}
    sensors = {name: record for name, record in own.items() if record is not None}
    return to_json_text(document | ({"sensors": sensors} if sensors else {}))


FORMAT = ExportFormat(
    write=to_json,
)
