"""Maps of OpenStreetMap drawn as text: a line for each road, way or node."""

from osm_tags import tags_of
from osm_text import OsmText, as_drawn, crossing

from geometry.junction import distance_to_outline_m
from geometry.maps.openstreetmap import read_openstreetmap

COMPASS = ("east", "north", "west", "south")
FOUR = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))


class OsmDrawing(OsmText):
    """A file in the making, in which ways that pass the same place share its node.

    Attributes
    ----------
    ids : list of int
        Of the lines drawn so far.
    nodes : dict of (float, float) to int
        Ids of nodes, by their places. [m]
    """

    def __init__(self):
        super().__init__()
        self.ids = []
        self.nodes = {}

    def draw(self, text):
        """Add what the lines of a text say, and return the drawing.

        Each line is a word, places in metres and tags:
        "way -80 0, 0 0: highway=service; width=6". A "road" is a residential one
        unless its tags say otherwise, a "node" is a single place. An area ends where
        it began.
        """
        for line in text.splitlines():
            if line.strip():
                self._draw_line(line)
        return self

    def _draw_line(self, line):
        """Add one road, way or node."""
        head, _, tag_text = line.partition(":")
        kind, _, place_text = head.strip().partition(" ")
        places = []
        for part in place_text.split(","):
            east_m, north_m = part.split()
            places.append((float(east_m), float(north_m)))
        tags = {}
        if kind == "road":
            tags["highway"] = "residential"
        for tag in tag_text.lstrip().split("; "):
            key, _, value = tag.partition("=")
            if key:
                tags[key] = value

        if kind == "node":
            (place,) = places
            self.nodes[place] = self.node(*place, **tags)
            self.ids.append(self.nodes[place])
            return

        for place in places:
            if place not in self.nodes:
                self.nodes[place] = self.node(*place)
        nodes = [self.nodes[place] for place in places]
        self.ids.append(self.way(nodes, tags))


def drawn(text):
    """A new drawing of what the lines of a text say."""
    return OsmDrawing().draw(text)


def drawn_crossing(tags="", *, bearings=FOUR, length_m=100.0):
    """A new drawing of streets that meet at (0, 0), with the same tags."""
    drawing = OsmDrawing()
    middle = crossing(drawing, bearings=bearings, length_m=length_m, **tags_of(tags))
    drawing.nodes[0.0, 0.0] = middle
    return drawing


def read_drawing(drawing, folder, **options):
    """The map that is read from a drawing, in the coordinates of the drawing."""
    source = read_openstreetmap(drawing.write(folder), **options)
    return as_drawn(source)


def assert_lanes_end_at_outlines(source):
    """Driving lanes of a junction end within 1 m of its outline."""
    outlines = {junction.id: junction.outline_m for junction in source.junctions}
    for lane in source.lanes:
        if lane.kind != "driving":
            continue
        for tip, name in ((0, lane.from_junction), (-1, lane.to_junction)):
            if name:
                point = lane.centreline_m[tip, :2]
                away_m = distance_to_outline_m(point, outlines[name])
                assert away_m <= 1.0, lane.id
