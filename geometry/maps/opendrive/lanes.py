"""Lanes of roads, joined along their lane sections."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from ..model import MapLane
from .roads import Road
from .sampling import SampledSection
from .tables import lane_kinds

_MIN_WIDTH_M = 0.05  # below it there is no lane yet, or none any more
_SAME_POINT_M = 0.005
_MIN_LENGTH_M = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadEnds:
    """Junctions that a road begins and ends at; empty: none."""

    start: str = ""
    end: str = ""


def lane_kind(lane_type: str) -> str | None:
    """One of ``LANE_KINDS``, or None where a type of the standard is no lane here."""
    return lane_kinds().get(lane_type.lower())


def build_lanes(road: Road, sections: Sequence[SampledSection], ends: RoadEnds) -> list[MapLane]:
    """Lanes of a road, each from one end to the other where its links lead through.

    Parameters
    ----------
    road : Road
        No connecting road of a junction.
    sections : sequence of SampledSection
        Of the road.
    ends : RoadEnds
        Junctions at its ends.
    """
    lanes = []
    used: dict[str, int] = {}
    for chain in _chains(sections):
        first = next(iter(chain))
        record = sections[first].lanes[chain[first]].record
        kind = lane_kind(record.type)
        if kind is None:
            continue
        # In traffic that keeps right, lanes right of the reference line follow it.
        follows = ((record.number < 0) != road.keeps_left) != record.is_reversed
        for points, width_m, at_start, at_end in _runs(sections, chain):
            name = f"{road.id}/{record.number}"
            if name in used:
                name = f"{name}/{first}"
            used[name] = used.get(name, 0) + 1
            if used[name] > 1:
                name = f"{name}:{used[name]}"
            junctions = ends.start if at_start else "", ends.end if at_end else ""
            lanes.append(
                MapLane(
                    id=name,
                    kind=kind,
                    width_m=width_m,
                    centreline_m=points if follows else points[::-1],
                    from_junction=junctions[0 if follows else 1],
                    to_junction=junctions[1 if follows else 0],
                )
            )
    return lanes


def _chains(sections: Sequence[SampledSection]) -> Iterator[dict[int, int]]:
    """Lanes that go on in one another: number by index of the section."""
    claimed: set[tuple[int, int]] = set()
    for start, section in enumerate(sections):
        for number in section.lanes:
            if (start, number) in claimed:
                continue
            chain = {start: number}
            for index in range(start + 1, len(sections)):
                following = _following(sections, index, chain[index - 1])
                if following is None or (index, following) in claimed:
                    break
                claimed.add((index, following))
                chain[index] = following
            yield chain


def _following(sections: Sequence[SampledSection], index: int, number: int) -> int | None:
    """Number in a section of the lane that goes on from one in the section before."""
    record = sections[index - 1].lanes[number].record
    # Some write only the link back.
    back = [
        other.record.number
        for other in sections[index].lanes.values()
        if number in other.record.predecessors
    ]
    for following in (*record.successors, *back):
        lane = sections[index].lanes.get(following)
        if lane is None:
            continue
        names_others = lane.record.predecessors and number not in lane.record.predecessors
        is_same = (
            lane_kind(lane.record.type) == lane_kind(record.type)
            and lane.record.is_reversed == record.is_reversed
            and (following > 0) == (number > 0)
        )
        if is_same and not names_others:
            return following
    return None


def _runs(
    sections: Sequence[SampledSection], chain: dict[int, int]
) -> Iterator[tuple[FloatArray, float, bool, bool]]:
    """Stretches of a chain where there is a lane: centreline, mean width, at the road's ends."""
    pieces = []
    for index, number in chain.items():
        section = sections[index]
        lane = section.lanes[number]
        pieces.append((section.beside(0.5 * (lane.inner_m + lane.outer_m)), lane.width_m))
    points = np.concatenate([piece[0] for piece in pieces])
    widths = np.concatenate([piece[1] for piece in pieces])
    is_there = np.concatenate([[False], widths >= _MIN_WIDTH_M, [False]])
    changes = np.flatnonzero(is_there[1:] != is_there[:-1])
    for begin, end in changes.reshape(-1, 2):
        line, width = points[begin:end], widths[begin:end]
        steps = np.hypot(*np.diff(line[:, :2], axis=0).T)
        length_m = float(steps.sum())
        if length_m < _MIN_LENGTH_M:
            continue
        mean_width_m = float((0.5 * (width[1:] + width[:-1]) * steps).sum()) / length_m
        is_new = np.append(True, steps > _SAME_POINT_M)
        is_new[-1] = True  # the very end stays, what is too close before it goes
        if steps[-1] <= _SAME_POINT_M and len(is_new) > 2:
            is_new[-2] = False
        is_new[0] = True
        at_start = min(chain) == 0 and begin == 0
        at_end = max(chain) == len(sections) - 1 and end == len(points)
        yield line[is_new], mean_width_m, bool(at_start), bool(at_end)
