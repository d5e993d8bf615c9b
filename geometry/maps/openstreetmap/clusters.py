"""Which nodes belong to which junction."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...arrays import FloatArray
from .defaults import DEFAULTS
from .elements import Tags
from .network import End, Network, Street, trace_streets

_FORK_DEG = 60.0  # two one-way roads that lie closer to one another than this are one road's


@dataclass(slots=True)
class Clusters:
    """Nodes of junctions, joined step by step.

    Attributes
    ----------
    of_row : dict of int to int
        Junction's number by node row.
    members : dict of int to list of int
        Node rows by junction's number.
    """

    of_row: dict[int, int] = field(default_factory=dict)
    members: dict[int, list[int]] = field(default_factory=dict)

    def add(self, row: int, number: int | None = None) -> None:
        """A node becomes part of a junction, by default of a new one."""
        if row not in self.of_row:
            self.of_row[row] = row if number is None else number
            self.members.setdefault(self.of_row[row], []).append(row)

    def join(self, one: int, other: int) -> None:
        """Make one junction of two."""
        if one != other:
            for row in self.members[other]:
                self.of_row[row] = one
            self.members[one] += self.members.pop(other)

    def drop(self, number: int) -> None:
        """Forget a junction."""
        for row in self.members.pop(number):
            del self.of_row[row]


def find_clusters(network: Network, node_tags: Mapping[int, Tags]) -> Clusters:
    """Nodes where roads meet, those of one junction together.

    Parameters
    ----------
    network : Network
        The roads.
    node_tags : dict of int to dict
        By row.

    Returns
    -------
    clusters : Clusters
        Nodes with three or more ends of roads, or of roads and yards where signals stand; on the
        ground; where a road only forks into its carriageways or ramps there is none. Nodes are
        joined along short ways, and all of a roundabout.
    """
    clusters = Clusters()
    for row, ends in network.ends.items():
        if _is_meeting(network, ends, node_tags.get(row, {})) and not is_fork(network, ends):
            clusters.add(row)
    _join_roundabouts(network, clusters)
    _join_near(network, clusters)
    return clusters


def _is_meeting(network: Network, ends: tuple[End, ...], tags: Tags) -> bool:
    edges = [network.edges[index] for index, _ in ends]
    if all(edge.level != 0 for edge in edges):
        return False
    n_full = sum(not edge.is_service for edge in edges)
    has_signals = tags.get("highway") == "traffic_signals" and n_full > 0
    return n_full >= 3 or (has_signals and len(edges) >= 3)


def is_fork(network: Network, ends: tuple[End, ...]) -> bool:
    """A node where one road splits into its two carriageways, or into road and ramp."""
    ends = tuple(end for end in ends if not network.edges[end[0]].is_service)
    if len(ends) != 3 or any(network.edges[index].is_roundabout for index, _ in ends):
        return False
    for stem in ends:
        one, other = (end for end in ends if end != stem)
        edge, other_edge = network.edges[one[0]], network.edges[other[0]]
        if not (edge.is_oneway and other_edge.is_oneway):
            continue
        bearings = [network.bearing_deg(end) for end in (stem, one, other)]
        apart = [abs((b - bearings[0] + 180.0) % 360.0 - 180.0) for b in bearings[1:]]
        between = abs((bearings[1] - bearings[2] + 180.0) % 360.0 - 180.0)
        if between > _FORK_DEG or min(apart) < 90.0:
            continue
        stem_edge = network.edges[stem[0]]
        is_split = not stem_edge.is_oneway and one[1] != other[1]
        is_ramp = one[1] == other[1] and any(
            e.tags["highway"].endswith("_link") or e.tags["highway"] == "motorway"
            for e in (edge, other_edge, stem_edge)
        )
        if is_split or is_ramp:
            return True
    return False


def _join_roundabouts(network: Network, clusters: Clusters) -> None:
    """Nodes of one ring, and of what touches it, become one junction."""
    limit_m = DEFAULTS["junction"]["max_roundabout_m"]
    rings = Clusters()
    for edge in network.edges:
        if edge.is_roundabout and not edge.is_service:
            begin, end = int(edge.rows[0]), int(edge.rows[-1])
            rings.add(begin)
            rings.add(end)
            rings.join(rings.of_row[begin], rings.of_row[end])
    for rows in rings.members.values():
        size_m = float(np.hypot(*np.ptp(network.positions_m[rows], axis=0)))
        numbers = sorted({clusters.of_row[row] for row in rows if row in clusters.of_row})
        if numbers and size_m <= limit_m:
            for number in numbers[1:]:
                clusters.join(numbers[0], number)
            for row in rows:
                clusters.add(row, numbers[0])


def _join_near(network: Network, clusters: Clusters) -> None:
    limits = DEFAULTS["junction"]
    links = []
    for street in trace_streets(network, clusters.of_row.__contains__):
        begin, end = int(street.rows[0]), int(street.rows[-1])
        if begin not in clusters.of_row or end not in clusters.of_row:
            continue
        is_wide = is_between_carriageways(network, street)
        if street.length_m <= limits["join_carriageways_m" if is_wide else "join_m"]:
            links.append((street.length_m, begin, end))
    for _, begin, end in sorted(links):
        one, other = clusters.of_row[begin], clusters.of_row[end]
        if one == other:
            continue
        rows = clusters.members[one] + clusters.members[other]
        if np.hypot(*np.ptp(network.positions_m[rows], axis=0)) <= limits["max_size_m"] or any(
            network.edges[index].is_roundabout for row in rows for index, _ in network.ends[row]
        ):
            clusters.join(one, other)


def is_between_carriageways(network: Network, street: Street) -> bool:
    """It links the two one-way carriageways of another street, across its median."""
    names = []
    for row in (int(street.rows[0]), int(street.rows[-1])):
        edges = [network.edges[index] for index, _ in network.ends[row]]
        names.append({edge.name for edge in edges if edge.is_oneway and edge.name})
    return bool(names[0] & names[1] - {street.parts[0][0].name})


def direction_at(points_m: FloatArray, over_m: float = 10.0) -> FloatArray:
    """Unit vector along the first metres of a line, (2,)."""
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(points_m, axis=0).T)))
    ahead = np.array([np.interp(over_m, along, points_m[:, axis]) for axis in (0, 1)])
    vector = ahead - points_m[0]
    unit: FloatArray = vector / max(float(np.hypot(*vector)), 1e-9)
    return unit
