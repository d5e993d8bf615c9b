"""Chosen units turned and zoomed step by step, large and small, where they hang."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from geometry.sensors import CameraModel

from ..candidates import CandidatePose, is_turn_useless
from ..optimiser import PlacementProblem, is_feasible
from .bench import Bench, add_poses
from .proposals import Places, moved
from .rows import RowBuilder
from .stage_values import StageValue, improves, stage_values

STEPS_DEG = (8.0, 4.0, 2.0, 1.0, 0.5)
"""Of yaw and pitch; and, in per cent, of the field of view of a varifocal lens."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Turned:
    """Where the search ended.

    Attributes
    ----------
    bench : Bench
        The one that it began with, and all poses that were tried behind.
    rows : tuple of int
        The best set in it.
    """

    bench: Bench
    rows: tuple[int, ...]


def turn(
    grid: PlacementProblem,
    bench: Bench,
    rows: Sequence[int],
    *,
    places: Places,
    build_rows: RowBuilder,
    end_s: float,
) -> Turned:
    """Compass search over yaw, pitch and field of view, one unit after the other.

    Parameters
    ----------
    grid : PlacementProblem
        The grid's problem.
    bench : Bench
        Poses at hand.
    rows : sequence of int
        The set to begin with, in the bench.
    places : Places
        Which of the units may be turned.
    build_rows : RowBuilder
        For the same mount position it should not cast rays again.
    end_s : float
        When to stop, on the monotonic clock. [s]

    Returns
    -------
    turned : Turned
        No step of any unit alone improves it, unless time was up; it is never worse than before in
        the order of the stages.

    Notes
    -----
    Compass search [1]_ shrinks its step where none improves. What a set is worth is a step function
    here - runs are avoided or not, frames come every tenth of a second -, so that a larger step may
    improve where smaller ones change nothing: all steps are tried at once.

    References
    ----------
    .. [1] T. Kolda, R. Lewis, V. Torczon, "Optimization by direct search", SIAM Review 45, 2003,
       section 3.
    """
    best = list(rows)
    values = stage_values(bench.problem(grid), best)
    position, n_settled = 0, 0
    while n_settled < len(best) and time.monotonic() < end_s:
        bench, found = _best_step(grid, bench, best, position, values, places, build_rows)
        if found is not None:
            best[position], values = found
            n_settled = 0
        else:
            n_settled += 1
            position = (position + 1) % len(best)
    return Turned(bench=bench, rows=tuple(best))


def _best_step(
    grid: PlacementProblem,
    bench: Bench,
    rows: Sequence[int],
    position: int,
    values: Sequence[StageValue],
    places: Places,
    build_rows: RowBuilder,
) -> tuple[Bench, tuple[int, tuple[StageValue, ...]] | None]:
    """Try the steps of one unit each way; the row of the best one, if that is an improvement."""
    unit, origin = bench.candidates[rows[position]], int(bench.origin[rows[position]])
    if not places.is_free[origin]:
        return bench, None
    steps = _steps(unit, origin, places)
    bench = add_poses(
        bench, grid, [(origin, pose) for pose in steps], places=places, build_rows=build_rows
    )
    known = {candidate.id: row for row, candidate in enumerate(bench.candidates)}
    # Only those in question: a problem on the whole bench takes longer to put together.
    others = [row for index, row in enumerate(rows) if index != position]
    tried = [known[pose.id] for pose in steps if known[pose.id] not in others]
    problem = bench.only(np.array([*others, *tried], dtype=np.int64)).problem(grid)
    best: tuple[int, tuple[StageValue, ...]] | None = None
    for index, row in enumerate(tried):
        units = [*range(len(others)), len(others) + index]
        own = stage_values(problem, units)
        if improves(own, values if best is None else best[1]) and is_feasible(problem, units):
            best = row, own
    return bench, best


def _steps(unit: CandidatePose, origin: int, places: Places) -> list[CandidatePose]:
    """Neighbours of a pose, each id once."""
    sensor = unit.sensor
    has_zoom = isinstance(sensor, CameraModel) and sensor.fov_range_deg is not None
    poses = []
    for step_deg, turn_sign, tilt_sign, zoom_sign in product(STEPS_DEG, *[(-1, 0, 1)] * 3):
        if zoom_sign and (turn_sign or tilt_sign or not has_zoom):
            continue
        pitch_deg = unit.pose.pitch_deg + tilt_sign * step_deg
        if turn_sign and is_turn_useless(sensor, pitch_deg=pitch_deg):
            continue
        zoom = (1.0 + 0.01 * step_deg) ** zoom_sign
        pose = moved(
            places,
            origin,
            height_m=float(unit.pose.position_m[2]),
            yaw_deg=unit.pose.yaw_deg + turn_sign * step_deg,
            pitch_deg=pitch_deg,
            fov_deg=zoom * sensor.horizontal_fov_deg,
        )
        if pose is not None and pose.id != unit.id:
            poses.append(pose)
    return list({pose.id: pose for pose in poses}.values())
