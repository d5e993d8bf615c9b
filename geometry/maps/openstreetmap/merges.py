"""Where motorways and their ramps merge or part: nobody walks there, and no ways cross."""

from collections.abc import Iterable, Sequence

from .elements import Tags
from .network import Edge

_MOTORWAYS = ("motorway", "motorway_link")
_TRUNKS = ("trunk", "trunk_link")
_FOR_PEOPLE = ("traffic_signals", "crossing")  # nodes
_SIDEWALKS = ("both", "left", "right", "yes")


def is_merge(arms: Sequence[tuple[Edge, bool]], nodes: Iterable[Tags]) -> bool:
    """Whether only motorways and trunk roads meet, without people on foot and crossing ways.

    Parameters
    ----------
    arms : sequence of (Edge, bool)
        The part of each road next to the meeting, and whether it runs away from there.
    nodes : iterable of Tags
        Of the nodes where they meet: signals and crossings are for people.
    """
    edges = [(edge, is_away) for edge, is_away in arms if not edge.is_service]
    if not edges or len(edges) < len(arms) or any(_has_people(edge.tags) for edge, _ in edges):
        return False
    if any(tags.get("highway") in _FOR_PEOPLE for tags in nodes):
        return False
    if all(_is_motorway(edge.tags) for edge, _ in edges):
        return True
    n_away = sum(is_away for _, is_away in edges)
    return (
        all(edge.is_oneway for edge, _ in edges)
        and all(_is_motorway(edge.tags) or edge.tags["highway"] in _TRUNKS for edge, _ in edges)
        and min(n_away, len(edges) - n_away) <= 1
    )


def _is_motorway(tags: Tags) -> bool:
    return tags["highway"] in _MOTORWAYS or tags.get("motorroad") == "yes"


def _has_people(tags: Tags) -> bool:
    return tags.get("foot") in ("yes", "designated") or tags.get("sidewalk") in _SIDEWALKS
