"""What is painted on the road, as rectangles: lane lines, stop lines, zebra crossings."""

from collections.abc import Iterator, Mapping
from itertools import pairwise

import numpy as np

from geometry.arrays import FloatArray
from geometry.scene import Lane, Scene

from .rectangles import polygon_distance

_BESIDE_M = 0.4  # so far beyond a lane's edge lies its neighbour
_MOUTH_M = 2.5  # a lane that ends so near the junction's outline ends at a stop line
_OVERLAP_M = 0.06


def build_road(scene: Scene) -> FloatArray:
    """Rectangles that together cover all lanes.

    Parameters
    ----------
    scene : Scene
        The junction; what its outline encloses is road, too, but is no rectangle.

    Returns
    -------
    rectangles : (n, 5) float
        As for :func:`placement.imaging.rectangles.rectangle_distance`.
    """
    return _stack(
        rectangle
        for lane in scene.lanes
        for rectangle in _strip(
            lane.centreline_m, 0.0, lane.width_m + 2.0 * _OVERLAP_M, _solid(lane.centreline_m)
        )
    )


def build_markings(scene: Scene, marks: Mapping[str, float]) -> FloatArray:
    """Rectangles that are painted.

    Parameters
    ----------
    scene : Scene
        Lanes, outline, crosswalks.
    marks : mapping
        ``[markings]`` of ``data/materials.toml``.

    Returns
    -------
    rectangles : (n, 5) float
        As :func:`build_road`.
    """
    return _stack(
        rectangle
        for part in (_lane_lines(scene, marks), _stop_lines(scene, marks), _zebras(scene, marks))
        for rectangle in part
    )


def _stack(rectangles: Iterator[list[float]]) -> FloatArray:
    return np.array(list(rectangles), dtype=np.float64).reshape(-1, 5)


def _lane_lines(scene: Scene, marks: Mapping[str, float]) -> Iterator[list[float]]:
    for lane in scene.lanes:
        if lane.kind != "driving":
            continue
        line = lane.centreline_m
        for side in (1.0, -1.0):  # left, right
            offset_m = side * 0.5 * lane.width_m
            neighbour, is_along = _neighbour(scene, lane, side)
            if neighbour is None:
                continue
            if neighbour.kind == "parking":
                dashes = _dashes(line, marks["parking_dash_m"], marks["parking_gap_m"])
            elif is_along:
                if side < 0.0:
                    continue  # drawn by the lane on the other side
                dashes = _dashes(line, marks["dash_m"], marks["gap_m"])
            else:  # oncoming: each draws its line of two
                offset_m -= side * 0.5 * marks["double_line_apart_m"]
                dashes = _solid(line)
            yield from _strip(line, offset_m, marks["line_width_m"], dashes)


def _neighbour(scene: Scene, lane: Lane, side: float) -> tuple[Lane | None, bool]:
    """The lane beside the middle of a lane, and whether it leads the same way."""
    at_m = 0.5 * _lengths(lane.centreline_m)[-1]
    point, ahead = _at(lane.centreline_m, at_m, side * (0.5 * lane.width_m + _BESIDE_M))
    for other in scene.lanes:
        if other is lane:
            continue
        starts, steps = other.centreline_m[:-1], np.diff(other.centreline_m, axis=0)
        length2 = np.maximum(np.einsum("ij,ij->i", steps, steps), 1e-12)
        share = np.clip(np.einsum("ij,ij->i", point - starts, steps) / length2, 0.0, 1.0)
        distance = np.linalg.norm(starts + share[:, None] * steps - point, axis=1)
        nearest = int(np.argmin(distance))
        if distance[nearest] < 0.5 * other.width_m:
            return other, bool(steps[nearest] @ ahead > 0.0)
    return None, False


def _stop_lines(scene: Scene, marks: Mapping[str, float]) -> Iterator[list[float]]:
    if not len(scene.outline_m):
        return
    for lane in scene.lanes:
        end_m = _lengths(lane.centreline_m)[-1] - 0.5 * marks["stop_line_m"]
        point, ahead = _at(lane.centreline_m, end_m, 0.0)
        if lane.kind == "driving" and polygon_distance(point, scene.outline_m) < _MOUTH_M:
            yaw = float(np.arctan2(ahead[1], ahead[0]))
            yield [*point.tolist(), yaw, 0.5 * marks["stop_line_m"], 0.5 * lane.width_m - 0.15]


def _zebras(scene: Scene, marks: Mapping[str, float]) -> Iterator[list[float]]:
    pitch_m = marks["zebra_bar_m"] + marks["zebra_gap_m"]
    for start, end in scene.crosswalks_m:
        length_m = float(np.linalg.norm(end - start))
        ahead = (end - start) / length_m
        yaw = float(np.arctan2(ahead[1], ahead[0]))
        n_bars = int(length_m / pitch_m)
        first_m = 0.5 * (length_m - (n_bars - 1) * pitch_m)
        for bar in range(n_bars):
            middle = start + (first_m + bar * pitch_m) * ahead
            half_sides = [0.5 * marks["zebra_bar_m"], 0.5 * marks["zebra_length_m"]]
            yield [*middle.tolist(), yaw, *half_sides]


def _lengths(line: FloatArray) -> FloatArray:
    """Arc length at each point of a line."""
    steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
    lengths: FloatArray = np.concatenate([[0.0], np.cumsum(steps)])
    return lengths


def _at(line: FloatArray, length_m: float, offset_m: float) -> tuple[FloatArray, FloatArray]:
    """Point beside a line, left positive, and the line's direction there."""
    lengths = _lengths(line)
    piece = int(np.clip(np.searchsorted(lengths, length_m) - 1, 0, len(line) - 2))
    step = line[piece + 1] - line[piece]
    ahead = step / np.linalg.norm(step)
    left = np.array([-ahead[1], ahead[0]])
    return line[piece] + (length_m - lengths[piece]) * ahead + offset_m * left, ahead


def _solid(line: FloatArray) -> list[tuple[float, float]]:
    lengths = _lengths(line).tolist()
    return [(start - _OVERLAP_M, end + _OVERLAP_M) for start, end in pairwise(lengths)]


def _dashes(line: FloatArray, dash_m: float, gap_m: float) -> list[tuple[float, float]]:
    starts = np.arange(0.5 * gap_m, _lengths(line)[-1] - dash_m, dash_m + gap_m)
    return [(start, start + dash_m) for start in starts.tolist()]


def _strip(
    line: FloatArray, offset_m: float, width_m: float, dashes: list[tuple[float, float]]
) -> Iterator[list[float]]:
    """Pieces of a strip that runs beside a line."""
    for start_m, end_m in dashes:
        middle, ahead = _at(line, 0.5 * (start_m + end_m), offset_m)
        yaw = float(np.arctan2(ahead[1], ahead[0]))
        yield [*middle.tolist(), yaw, 0.5 * (end_m - start_m), 0.5 * width_m]
