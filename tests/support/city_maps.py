"""A street with three junctions, drawn as an OpenStreetMap file, and what is asked
there.
"""

from itertools import pairwise
from pathlib import Path

from osm_text import OsmText

from placement.question import Question

PLACES_M = (
    (0.0, 0.0),
    (250.0, 0.0),
    (500.0, 10.0),
)
FEW_RUNS = Question(cases="CPNC-50", along_arms="0", speeds="50")
FEW_RUNS_OPTIONS = ("--cases", "CPNC-50", "--along-arms", "0", "--speeds", "50")


def write_city(folder: Path, name: str = "tiny.osm", *, east_m: float = 0.0) -> Path:
    """Two crossings and between them a junction of three arms; lamps and houses at
    each.
    """
    osm = OsmText()
    places = [(x + east_m, y) for x, y in PLACES_M]
    nodes = [osm.node(*place) for place in places]
    ends = [osm.node(east_m - 110.0, 0.0), *nodes, osm.node(east_m + 610.0, 10.0)]
    for one, other in pairwise(ends):
        osm.road([one, other], name="Main Street")

    for letter, node, (x, y) in zip("ABC", nodes, places, strict=True):
        for up in (100.0,) if letter == "B" else (100.0, -100.0):
            osm.road([node, osm.node(x, y + up)], name=f"{letter} Lane")
        house = [
            (x + 17.0, y + 17.0),
            (x + 37.0, y + 17.0),
            (x + 37.0, y + 37.0),
        ]
        osm.way(
            [*house, (x + 17.0, y + 37.0), house[0]], {"building": "yes", "height": "9"}
        )
        for way in (6.0, -6.0):
            osm.node(x + way, y + way, highway="street_lamp")

    osm.node(places[2][0] + 8.0, places[2][1], highway="traffic_signals")
    return osm.write(folder, name)
