"""Ways on which nothing may stand, besides the roads for cars.

They are footways, cycle tracks, ways to yards, streets for buses, and tracks of
trams and trains.
"""

from collections.abc import Iterator
from functools import partial

from ..source_map import MapPath
from .elements import DEFAULTS, Elements, Tags, Way, numbered, tagged_length_m
from .network import is_for_cars, level, lines_of

_PATHS = DEFAULTS["paths"]
_WIDTHS_M = (0.5, 30.0)
_WIDTH_KEYS = ("width", "est_width")


def is_path(way: Way) -> bool:
    """True if people, cycles, buses or trains move on a way, and cars do not."""
    return _usual_width_m(way.tags) is not None and not is_for_cars(way.tags)


def find_paths(elements: Elements) -> Iterator[MapPath]:
    """Ways on the ground on which people, cycles, buses or trains move.

    Senseless widths are noted.

    Parameters
    ----------
    elements : Elements
        Elements of the file.

    Yields
    ------
    path : MapPath
        Those that surround a square have none.
    """
    for way in elements.ways:
        usual_m = _usual_width_m(way.tags)
        is_square = way.tags.get("area") == "yes"
        is_left_out = is_for_cars(way.tags) or is_square or level(way.tags)
        if usual_m is None or is_left_out:
            continue
        note = partial(elements.omissions.add, "ways", f"way {way.id}")
        width_m = tagged_length_m(way.tags, _WIDTH_KEYS, _WIDTHS_M, note)
        if width_m is None:
            width_m = usual_m
        for number, line_m in enumerate(lines_of(way, elements)):
            name = numbered(f"w{way.id}", number)
            yield MapPath(id=name, line_m=line_m, width_m=width_m)


def _usual_width_m(tags: Tags) -> float | None:
    """Usual width of a way of its kind, in metres; None: nobody moves there."""
    railway = _PATHS["railways_m"].get(tags.get("railway", ""))
    highway = tags.get("highway", "")
    if highway in DEFAULTS["roads"]:
        highway = "road"
    width_m: float | None = _PATHS["widths_m"].get(highway, railway)
    return width_m
