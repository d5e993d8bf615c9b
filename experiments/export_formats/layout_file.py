"""The layout file itself: what ``--layout`` reads; ``data/layout.schema.json`` describes it."""

from geometry.catalogue import own_sensor_record
from placement.layout import SCHEMA, Layout, layout_records

from .json_text import to_json_text


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
