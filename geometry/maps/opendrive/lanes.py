"""Lanes of OpenDRIVE roads, sampled as points and joined to lines.

A road is sampled section by section. Lanes of consecutive sections that
continue each other become one line, and short stubs at junctions are joined
to the lanes beyond them.
"""

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...errors import InputError, refuse
from ...lines import along_m, length_m, steps_m, true_runs
from ...scene import RoadUser
from ..source_map import MapLane
from .roads import (
    MAX_COORDINATE_M,
    LaneRecord,
    LaneSection,
    PiecewiseCubic,
    Road,
    evaluate,
    lane_kinds,
    slope,
)

# Of a file.
MAX_POINTS = 5_000_000
# Below the 3 cm that are asked for: bounds of bends are sampled.
_CHORD_ERROR_M = 0.02
# Cars turn on these lines.
_TURN_CHORD_ERROR_M = 0.002
_MAX_STEP_M = 5.0
# The longest road that is straight takes 20 000.
_MAX_PIECE_POINTS = 100_000
_MAX_EDGE_M = 10_000.0
_MAX_HEIGHT_M = 10_000.0
# Of one piece: some thirty rounds.
_MAX_TURN_RAD = 200.0
# Below it there is no lane yet, or none any more.
_MIN_WIDTH_M = 0.05
_SAME_POINT_M = 0.005
_MIN_LENGTH_M = 0.01
# of a lane next to a junction: cases are laid there, so its width there counts
_STAGED_M = 30.0
# Shorter lanes at a junction are no lanes of their own.
_STUB_M = 5.0
# Between such a stub and the lane that goes on.
_GAP_M = 0.5
# Junctions at the start and at the end of a road; empty: none.
RoadEnds = tuple[str, str]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampledLane:
    """Lane of a section as points.

    Attributes
    ----------
    record : LaneRecord
        The lane as the file has it.
    inner_m : (n,) float
        Edge towards the reference line, to the left of that. [m]
    outer_m : (n,) float
        Edge away from the reference line, to the left of that. [m]
    """

    record: LaneRecord
    inner_m: FloatArray
    outer_m: FloatArray

    @property
    def width_m(self) -> FloatArray:
        """Full width at the stations, not below 0, (n,)."""
        side = -1.0
        if self.record.number > 0:
            side = 1.0
        return np.maximum(side * (self.outer_m - self.inner_m), 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampledSection:
    """Lane section as points.

    Attributes
    ----------
    s_m : (n,) float
        Stations from its start to its end. [m]
    points_m : (n, 3) float
        Of the reference line. [m]
    left : (n, 2) float
        Unit vectors to the left of it.
    rise : (n,) float
        By which the surface rises towards it: sine of the superelevation.
    lanes : dict[int, SampledLane]
        By number.
    """

    s_m: FloatArray
    points_m: FloatArray
    left: FloatArray
    rise: FloatArray
    lanes: dict[int, SampledLane]

    def points_at(self, t_m: FloatArray) -> FloatArray:
        """Points of the surface beside the reference line, (n, 3)."""
        points = self.points_m.copy()
        points[:, :2] += t_m[:, None] * self.left
        points[:, 2] += t_m * self.rise
        return points

    def surface_m(self) -> FloatArray:
        """Points of the surface: on the reference line and both edges, (m, 3)."""
        edges = [lane.outer_m for lane in self.lanes.values()] or [
            np.zeros(len(self.s_m))
        ]
        sides = [np.zeros(len(self.s_m)), np.min(edges, axis=0), np.max(edges, axis=0)]
        return np.concatenate([self.points_at(t_m) for t_m in sides])


def sample_road(
    road: Road,
    *,
    chord_error_m: float = _CHORD_ERROR_M,
) -> tuple[SampledSection, ...]:
    """Sample all lane sections of a road.

    Stations are at most 5 m apart along any lane.

    Parameters
    ----------
    road : Road
        The road.
    chord_error_m : float
        Largest distance of a chord from the curve. [m]

    Returns
    -------
    sections : tuple of SampledSection
        In order along the road.

    Raises
    ------
    InputError
        That needs too many points.
    """
    bends = road.line.bends()
    return tuple(
        _sample_section(road, section, bends, chord_error_m)
        for section in road.sections
    )


def _sample_section(
    road: Road,
    section: LaneSection,
    bends: FloatArray,
    chord_error_m: float,
) -> SampledSection:
    """Sample one lane section of a road.

    The section is cut where the line or a cubic begins a new piece; each
    interval gets the steps that its bends need.

    Parameters
    ----------
    road : Road
        The road.
    section : LaneSection
        The lane section.
    bends : (n, 3) float
        See :meth:`~.roads.ReferenceLine.bends`.
    chord_error_m : float
        Largest distance of a chord from the curve. [m]

    Returns
    -------
    sampled : SampledSection
        With points for each lane.

    Raises
    ------
    InputError
        The section needs too many points, or leads too far away.
    """
    starts, lengths = _intervals(road, section)
    inside = starts + 0.5 * lengths
    n_edges = 1 + len(section.left) + len(section.right)
    _check_count(road, len(starts) * n_edges)
    # Edges of the lanes as cubics, each lane added to the edge inside it.
    center = road.offset.rebased(starts, inside)
    edges = {0: center}
    inner_of = {}
    for side, sign in ((section.left, 1.0), (section.right, -1.0)):
        has_widths = any(len(lane.width.starts_m) for lane in side)
        inner = center
        inner_number = 0
        for lane in side:
            if has_widths or not len(lane.border.starts_m):
                inner = inner + sign * lane.width.rebased(starts, inside)
            else:
                inner = _border(lane, starts, inside, center, sign)
            edges[lane.number] = inner
            inner_of[lane.number] = inner_number
            inner_number = lane.number
    elevation = road.elevation.rebased(starts, inside)

    # Steps of each interval, numbered one after the other; the last point is added.
    sides = np.stack([*edges.values()])
    n_steps = _count_steps(
        road,
        lengths,
        inside,
        sides,
        elevation,
        bends,
        chord_error_m,
    )
    _check_count(road, float(n_steps.sum()) * n_edges)
    first = np.cumsum(n_steps) - n_steps
    interval = np.repeat(np.arange(len(starts)), n_steps)
    ds = (np.arange(len(interval)) - first[interval]) * (lengths / n_steps)[interval]
    interval = np.append(interval, len(starts) - 1)
    ds = np.append(ds, lengths[-1])

    # Points of the line, the edges and the heights at all stations.
    s_m = starts[interval] + ds
    points, heading = road.line.at(s_m, inside[interval])
    t_m = {number: evaluate(ds, cubic[interval]) for number, cubic in edges.items()}
    farthest_m = float(np.abs(points).max())
    if farthest_m > MAX_COORDINATE_M:
        expected = f"at most {MAX_COORDINATE_M:g} m"
        raise InputError(f"{road.where} planView", farthest_m, expected)
    height = evaluate(ds, elevation[interval]) + road.base_m
    highest_m = float(np.abs(height).max())
    if highest_m > _MAX_HEIGHT_M:
        expected = f"heights of at most {_MAX_HEIGHT_M:g} m"
        raise InputError(f"{road.where} elevationProfile", highest_m, expected)
    bank_rad = evaluate(ds, road.bank.rebased(starts, inside)[interval])
    lanes: dict[int, SampledLane] = {}
    for lane in (*section.left, *section.right):
        lanes[lane.number] = SampledLane(
            record=lane,
            inner_m=t_m[inner_of[lane.number]],
            outer_m=t_m[lane.number],
        )
    return SampledSection(
        s_m=s_m,
        points_m=np.column_stack([points, height]),
        left=np.stack([-np.sin(heading), np.cos(heading)], axis=1),
        rise=np.sin(bank_rad),
        lanes=lanes,
    )


def _check_count(road: Road, n_points: float) -> None:
    """Refuse a road that needs too many points."""
    if n_points > MAX_POINTS:
        refuse(
            road.where,
            f"{n_points:,.0f} points to draw it",
            f"at most {MAX_POINTS:,}",
        )


def _intervals(road: Road, section: LaneSection) -> tuple[FloatArray, FloatArray]:
    """Stretches of a section in which line and cubics have one piece.

    Parameters
    ----------
    road : Road
        The road.
    section : LaneSection
        The lane section.

    Returns
    -------
    starts_m : (n,) float
        Begins. [m]
    lengths_m : (n,) float
        Lengths. [m]
    """
    cubics: list[PiecewiseCubic] = [road.offset, road.elevation, road.bank]
    for lane in (*section.left, *section.right):
        cubics += [lane.width, lane.border]
    starts_m = [road.line.starts_m, *(cubic.starts_m for cubic in cubics)]
    inner = np.concatenate(starts_m)
    inner = inner[(inner > section.start_m) & (inner < section.end_m)]
    starts = np.unique(np.append(inner, section.start_m))
    return starts, np.diff(np.append(starts, max(section.end_m, section.start_m)))


def _border(
    lane: LaneRecord,
    starts: FloatArray,
    inside: FloatArray,
    center: FloatArray,
    sign: float,
) -> FloatArray:
    """Outer edge of a lane from <border>, as coefficients (n, 4).

    A border is a t coordinate, but some files write a distance on either side.

    Parameters
    ----------
    lane : LaneRecord
        The lane.
    starts : (n,) float
        Begins of the intervals. [m]
    inside : (n,) float
        Their middles. [m]
    center : (n, 4) float
        Offset of the lanes from the reference line.
    sign : {1.0, -1.0}
        Side: left, right.

    Returns
    -------
    edge : (n, 4) float
        To the left of the reference line.
    """
    border = lane.border.rebased(starts, inside)
    ds = inside - starts
    is_beyond = sign * (evaluate(ds, border) - evaluate(ds, center)) < 0.0
    return np.where(is_beyond[:, None], -border, border)


def _count_steps(
    road: Road,
    lengths: FloatArray,
    inside: FloatArray,
    edges: FloatArray,
    elevation: FloatArray,
    bends: FloatArray,
    chord_error_m: float,
) -> NDArray[np.int64]:
    """Steps for each interval of a section, (n,).

    A chord of h metres leaves a curve by at most h^2 / 8 times its second
    derivative, here that of p(s) + t(s) n(s): the bend of the line, widened
    outwards, the change of t, and the elevation.

    Parameters
    ----------
    road : Road
        The road.
    lengths : (n,) float
        Lengths of the intervals. [m]
    inside : (n,) float
        Their middles. [m]
    edges : (n_edges, n, 4) float
        Edges of the lanes, as cubics.
    elevation : (n, 4) float
        Heights, as cubics.
    bends : (n_pieces, 3) float
        See :meth:`~.roads.ReferenceLine.bends`.
    chord_error_m : float
        Largest distance of a chord from the curve. [m]

    Returns
    -------
    n_steps : (n,) int
        At least 1.

    Raises
    ------
    InputError
        The line turns too often, or an edge lies too far off.
    """
    piece = np.maximum(np.searchsorted(road.line.starts_m, inside, side="right") - 1, 0)
    curvature, change, stride = bends[piece].T
    tries = (0.0 * lengths, 0.5 * lengths, lengths)
    t = np.abs([evaluate(ds, edges) for ds in tries]).max(axis=(0, 1))
    aside = np.abs([slope(ds, edges) for ds in tries]).max(axis=(0, 1))
    c = edges[..., 2]
    # (n_edges, n) each.
    d = edges[..., 3]
    second = np.maximum(np.abs(2.0 * c), np.abs(2.0 * c + 6.0 * d * lengths)).max(
        axis=0
    )
    bent = 2.0 * elevation[:, 2]
    steeper = 6.0 * elevation[:, 3] * lengths
    rise = np.maximum(np.abs(bent), np.abs(bent + steeper))
    turn = curvature * stride * lengths
    if turn.max() > _MAX_TURN_RAD:
        where = road.line.wheres[piece[int(turn.argmax())]]
        got = f"{turn.max():.3g} rad"
        refuse(where, f"a curve that turns by {got}", f"at most {_MAX_TURN_RAD:g} rad")
    if t.max() > _MAX_EDGE_M:
        where = f"{road.where}: edge of a lane"
        most = f"at most {_MAX_EDGE_M:g} m off"
        raise InputError(where, float(t.max()), most)
    widening = 1.0 + curvature * t
    bend = stride * (
        stride * curvature * widening + 2.0 * curvature * aside + change * t
    )
    by_chord = lengths * np.sqrt((bend + second + rise) / (8.0 * chord_error_m))
    by_step = lengths * (stride * widening + aside) / _MAX_STEP_M
    n_steps = np.ceil(np.maximum(np.maximum(by_chord, by_step), 1.0) - 1.0e-9)
    if n_steps.max() > _MAX_PIECE_POINTS:
        where = road.line.wheres[piece[int(n_steps.argmax())]]
        expected = (
            f"a curve, or widths along it, that at most {_MAX_PIECE_POINTS:,} follow"
        )
        refuse(where, f"bends that take {n_steps.max():.3g} points to follow", expected)
    return np.asarray(n_steps, dtype=np.int64)


# ---------- lanes
def lane_kind(lane_type: str) -> str | None:
    """One of ``LANE_KINDS``, or None if a type is no lane here."""
    return lane_kinds().get(lane_type.lower())


def build_lanes(
    road: Road,
    sections: Sequence[SampledSection],
    ends: RoadEnds,
) -> Iterator[MapLane]:
    """Lanes of a road outside junctions, joined along its sections.

    Parameters
    ----------
    road : Road
        The road.
    sections : sequence of SampledSection
        Sampled sections of the road, in order.
    ends : RoadEnds
        Junctions at the start and at the end of the road.

    Yields
    ------
    lane : MapLane
        In driving direction.
    """
    used: Counter[str] = Counter()
    closed: tuple[RoadUser, ...] = ()
    if road.is_motorway:
        closed = ("on foot", "bicycle")
    for chain in _chains(sections):
        first = next(iter(chain))
        record = sections[first].lanes[chain[first]].record
        kind = lane_kind(record.type)
        if kind is None:
            continue
        # In traffic that keeps right, lanes right of the reference line follow it.
        follows = ((record.number < 0) != road.keeps_left) != record.is_reversed
        for points, widths_m, at_start, at_end in _runs(sections, chain):
            name = f"{road.id}/{record.number}"
            if name in used:
                name = f"{name}/{first}"
            used[name] += 1
            if used[name] > 1:
                name = f"{name}:{used[name]}"
            start_junction = ""
            if at_start:
                start_junction = ends[0]
            end_junction = ""
            if at_end:
                end_junction = ends[1]
            width_m = _width_m(
                points,
                widths_m,
                bool(start_junction),
                bool(end_junction),
            )
            # The limit is that where it leads into a junction, or else out of one.
            if follows:
                is_at_end = bool(end_junction)
            else:
                is_at_end = not start_junction
            if is_at_end:
                last = max(chain)
                at_m = road.length_m
            else:
                last = min(chain)
                at_m = 0.0
            its_lane = sections[last].lanes[chain[last]]
            # Centrelines run in driving direction.
            line_m = points
            before = start_junction
            after = end_junction
            if not follows:
                line_m = points[::-1]
                before = end_junction
                after = start_junction
            yield MapLane(
                id=name,
                kind=kind,
                width_m=width_m,
                centreline_m=line_m,
                from_junction=before,
                to_junction=after,
                speed_limit_kmh=road.speed_limit_kmh(at_m, its_lane.record),
                closed_to=closed,
            )


def connecting_lanes(road: Road) -> list[MapLane]:
    """Driving lanes of a connecting road through its junction."""
    sections = sample_road(road, chord_error_m=_TURN_CHORD_ERROR_M)
    lanes = build_lanes(road, sections, (road.junction, road.junction))
    return [
        one
        for one in lanes
        if one.kind == "driving" and one.from_junction and one.to_junction
    ]


def _chains(sections: Sequence[SampledSection]) -> Iterator[dict[int, int]]:
    """Lanes that continue each other: number by index of the section."""
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


def _following(
    sections: Sequence[SampledSection],
    index: int,
    number: int,
) -> int | None:
    """Number of the lane that continues one of the section before.

    Parameters
    ----------
    sections : sequence of SampledSection
        Sampled sections of the road, in order.
    index : int
        Index of the section.
    number : int
        Number of the lane in the section before.

    Returns
    -------
    following : int or None
        None: no lane of the same kind and direction continues it.
    """
    record = sections[index - 1].lanes[number].record
    lanes = sections[index].lanes
    # Some write only the link back.
    back = [
        other for other, lane in lanes.items() if number in lane.record.predecessors
    ]
    for following in (*record.successors, *back):
        lane = lanes.get(following)
        if lane is None:
            continue
        names_others = (
            lane.record.predecessors and number not in lane.record.predecessors
        )
        is_same = (
            lane_kind(lane.record.type) == lane_kind(record.type)
            and lane.record.is_reversed == record.is_reversed
            and (following > 0) == (number > 0)
        )
        if is_same and not names_others:
            return following
    return None


def _width_m(
    points: FloatArray,
    widths_m: FloatArray,
    at_begin: bool,
    at_end: bool,
) -> float:
    """Mean width of a lane next to its junctions, in metres.

    Without a junction it is the mean width all along.

    Parameters
    ----------
    points : (n, 3) float
        Centreline. [m]
    widths_m : (n,) float
        Widths at its points. [m]
    at_begin : bool
        A junction lies at its begin.
    at_end : bool
        A junction lies at its end.

    Returns
    -------
    width_m : float
        Weighted by length. [m]
    """
    along = along_m(points)
    steps = steps_m(points)
    middle_m = 0.5 * (along[1:] + along[:-1])
    counts = at_begin & (middle_m <= _STAGED_M)
    counts |= at_end & (along[-1] - middle_m <= _STAGED_M)
    if not counts.any():
        counts[0] = at_begin
        counts[-1] = at_end
    if not counts.any():
        counts[:] = True
    mean_widths_m = 0.5 * (widths_m[1:] + widths_m[:-1])
    return float(np.average(mean_widths_m[counts], weights=steps[counts]))


def _runs(
    sections: Sequence[SampledSection],
    chain: dict[int, int],
) -> Iterator[tuple[FloatArray, FloatArray, bool, bool]]:
    """Stretches of a chain on which there is a lane.

    Parameters
    ----------
    sections : sequence of SampledSection
        Sampled sections of the road, in order.
    chain : dict[int, int]
        Number of the lane, by index of the section.

    Yields
    ------
    run : ((n, 3) float, (n,) float, bool, bool)
        Centreline, widths, and whether it begins at the road's start and ends
        at its end. [m]
    """
    lanes = [(sections[index], sections[index].lanes[chain[index]]) for index in chain]
    middles = [
        part.points_at(0.5 * (lane.inner_m + lane.outer_m)) for part, lane in lanes
    ]
    points = np.concatenate(middles)
    widths = np.concatenate([lane.width_m for _, lane in lanes])
    for begin, end in true_runs(widths >= _MIN_WIDTH_M):
        line = points[begin:end]
        width = widths[begin:end]
        steps = steps_m(line)
        if steps.sum() < _MIN_LENGTH_M:
            continue
        is_new = np.append(True, steps > _SAME_POINT_M)
        # The end stays, and a point too close before it goes.
        is_new[-1] = True
        if steps[-1] <= _SAME_POINT_M and len(is_new) > 2:
            is_new[-2] = False
        is_new[0] = True
        at_start = min(chain) == 0 and begin == 0
        at_end = max(chain) == len(sections) - 1 and end == len(points)
        yield line[is_new], width[is_new], bool(at_start), bool(at_end)


# ---------- short roads at the mouth of a junction
def join_stubs(lanes: Sequence[MapLane]) -> list[MapLane]:
    """Lanes, where very short ones at a junction are joined to the next.

    A stub's points and junction go to the lane of its kind that continues
    within half a metre and keeps its id.

    Parameters
    ----------
    lanes : sequence of MapLane
        Lanes outside junctions.

    Returns
    -------
    joined : list of MapLane
        Stubs that no lane continues stay.
    """
    joined = list(lanes)
    waiting = deque(lanes)
    while waiting:
        stub = waiting.popleft()
        leads_out = bool(stub.from_junction)
        is_short = length_m(stub.centreline_m) < _STUB_M and leads_out != bool(
            stub.to_junction
        )
        # By now it may be part of another.
        if not is_short or stub not in joined:
            continue
        # The stub's free end, and the ends of other lanes that it may continue.
        own = 0
        others = -1
        if leads_out:
            own = -1
            others = 0
        tips = np.array([lane.centreline_m[others] for lane in joined])
        gaps_m = np.linalg.norm(tips - stub.centreline_m[own], axis=1)
        for at in np.argsort(gaps_m, kind="stable")[
            : int((gaps_m <= _GAP_M).sum())
        ].tolist():
            lane = joined[at]
            is_taken = lane.to_junction
            if leads_out:
                is_taken = lane.from_junction
            if lane is stub or lane.kind != stub.kind or is_taken:
                continue
            pieces = [lane, stub]
            if leads_out:
                pieces = [stub, lane]
            lengths_m = [length_m(piece.centreline_m) for piece in pieces]
            joined[at] = replace(
                lane,
                width_m=float(
                    np.average([one.width_m for one in pieces], weights=lengths_m)
                ),
                centreline_m=np.concatenate(
                    [pieces[0].centreline_m[:-1], pieces[1].centreline_m]
                ),
                from_junction=pieces[0].from_junction,
                to_junction=pieces[1].to_junction,
            )
            # It may be short, too.
            waiting.append(joined[at])
            joined.remove(stub)
            break
    return joined
