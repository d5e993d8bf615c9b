"""Which candidate pose detects the VRU in which frame: V[c, f], as bits; and by levels of a score.

With a score, every level of a run is a run of its own with a later deadline and a part
of the weight, so that to the optimiser, its proofs and their checker it is one run
more.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.errors import refuse
from scenarios.aeb import AebRule
from scenarios.confirmation import is_in_time
from scenarios.runs import FrameAxis
from scenarios.scores import Levels


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DetectionTable:
    """Detections of every candidate pose in every frame."""

    pose_ids: tuple[str, ...]  #: ids of the candidate poses: the rows
    axis: FrameAxis  #: runs and frames: the columns
    packed: NDArray[
        np.uint8
    ]  #: (n_poses, ceil(n_frames / 8)): along the frames, lowest bit first

    def __post_init__(self) -> None:
        packed = np.array(self.packed, dtype=np.uint8)
        shape = (len(self.pose_ids), -(-self.axis.n_frames // 8))
        if packed.shape != shape:
            refuse("packed", f"shape {packed.shape}", f"shape {shape}")
        object.__setattr__(self, "packed", freeze(packed))

    @property
    def n_poses(self) -> int:
        """Number of candidate poses."""
        return len(self.pose_ids)

    def detected(
        self, pose_index: "NDArray[np.int64] | list[int] | slice"
    ) -> BoolArray:
        """Rows of the table, unpacked: V[c, f], (n, n_frames) bool."""
        bits = np.unpackbits(
            self.packed[pose_index], axis=1, count=self.axis.n_frames, bitorder="little"
        )
        return bits.astype(bool)

    def __repr__(self) -> str:
        return f"DetectionTable({self.n_poses} poses, {self.axis.n_frames} frames)"


def pack_table(
    pose_ids: tuple[str, ...], axis: FrameAxis, detected: BoolArray
) -> DetectionTable:
    """Detection table from an array of booleans, (n_poses, n_frames)."""
    return DetectionTable(
        pose_ids=pose_ids,
        axis=axis,
        packed=np.packbits(detected, axis=1, bitorder="little"),
    )


# ---------- levels of a score as runs
_ROWS = 256  # unpacked at a time
_BELOW = "<"
_BLIND = " (blind)"
_AT_ONCE_S = (
    1.0e-12  # from one frame after the last moment to the next, in the clock of a level
)


def level_table(table: DetectionTable, levels: Levels, rule: AebRule) -> DetectionTable:
    """Table with a run for every level, see :func:`level_axis`, from that of the runs."""
    axis, frames = level_axis(table.axis, levels, rule)
    return _of_frames(table, axis, frames)


def _of_frames(
    table: DetectionTable, axis: FrameAxis, frames: IntArray
) -> DetectionTable:
    """Table whose columns are some frames of another one."""
    packed = np.empty((table.n_poses, -(-axis.n_frames // 8)), dtype=np.uint8)
    for row in range(0, table.n_poses, _ROWS):
        bits = table.detected(slice(row, row + _ROWS))[:, frames]
        packed[row : row + _ROWS] = np.packbits(bits, axis=1, bitorder="little")
    return DetectionTable(pose_ids=table.pose_ids, axis=axis, packed=packed)


def _of_runs(axis: FrameAxis, rows: Sequence[int], **changes: Any) -> FrameAxis:
    """Axis whose runs are called, driven and seen as those of some rows of another one."""
    words = {
        name: tuple(getattr(axis, name)[row] for row in rows)
        for name in ("cases", "approaches", "positions", "weathers")
    }
    return replace(
        axis, vut_speed_kmh=axis.vut_speed_kmh[list(rows)], **(words | changes)
    )


def level_axis(
    axis: FrameAxis, levels: Levels, rule: AebRule
) -> tuple[FrameAxis, IntArray]:
    """Axis with a run for every level of a score, and which frames of `axis` are its frames.

    A level is reached if the run is avoided, or if the VUT brakes for a track confirmed
    after the last moment, but before the level's deadline; such a track is not lost any
    more. So a level's clock stands still from the last moment on, all but for a
    picosecond a frame, and ends at its deadline: what is in time or alive there is so
    by the deadline. Margins are those to the last moment, 0 for what is confirmed after
    it.

    Ids of levels that are not for avoiding end in "<10" and so on: the speed at contact
    that they stay below, in km/h. Weights are those of the runs times the gain.
    """
    ids = []
    starts = [0]
    frames = []
    times = []
    deadlines = []
    for run, below_kmh, deadline_s in zip(
        levels.run_index.tolist(),
        levels.below_kmh.tolist(),
        levels.deadline_s.tolist(),
        strict=True,
    ):
        where = axis.frames_of(run)
        time_s = axis.time_s[where]
        last_s = float(axis.last_brake_time_s[run])
        name = axis.run_ids[run]
        if below_kmh > 0.0:
            name += f"{_BELOW}{below_kmh:g}"
            n_frames = int(
                is_in_time(time_s, deadline_s, latency_s=rule.latency_s).sum()
            )
            if n_frames:
                time_s, last_s = _at_once(time_s[:n_frames], last_s, deadline_s, rule)
            else:  # nobody is in time
                last_s = -np.inf
        ids.append(name)
        frames.append(np.arange(where.start, where.start + len(time_s)))
        times.append(time_s)
        starts.append(starts[-1] + len(time_s))
        deadlines.append(last_s)
    index = levels.run_index.tolist()
    levelled = _of_runs(
        axis,
        index,
        run_ids=tuple(ids),
        weight=axis.weight[index] * levels.gain,
        last_brake_time_s=np.array(deadlines),
        run_start=np.array(starts),
        time_s=np.concatenate(times),
    )
    return levelled, np.concatenate(frames)


def run_of_level(level_id: str) -> str:
    """Id of the run that a level belongs to, by that of the level; of a run its own.

    The same for a run that is driven by a VUT that does not see, see
    :func:`mixed_table`.
    """
    return level_id.removesuffix(_BLIND).partition(_BELOW)[0]


def has_levels(axis: FrameAxis) -> bool:
    """True if some runs are levels."""
    return any(_BELOW in name for name in axis.run_ids)


def repeated_axis(
    axis: FrameAxis,
    endings: Sequence[str],
    *,
    weight: FloatArray,
    last_brake_time_s: FloatArray,
) -> FrameAxis:
    """The axis once for each ending of its runs' ids, one after the other.

    Weights and last brake times are of all repeated runs, (n_endings * n_runs,).
    """
    n = len(endings)
    starts = [axis.run_start[:-1] + index * axis.n_frames for index in range(n)]
    return _of_runs(
        axis,
        [*range(axis.n_runs)] * n,
        run_ids=tuple(f"{run}{ending}" for ending in endings for run in axis.run_ids),
        weight=weight,
        last_brake_time_s=last_brake_time_s,
        run_start=np.append(np.concatenate(starts), n * axis.n_frames),
        time_s=np.tile(axis.time_s, n),
    )


# ---------- cars that see, and cars that do not
def mixed_table(table: DetectionTable, share: float) -> DetectionTable:
    """Table with every run twice: by a VUT that sees, of so much of its weight, then by another.

    Ids of runs that are driven by a VUT that does not see end in " (blind)".
    """
    axis = table.axis
    twice = repeated_axis(
        axis,
        ("", _BLIND),
        weight=np.concatenate([share * axis.weight, (1.0 - share) * axis.weight]),
        last_brake_time_s=np.tile(axis.last_brake_time_s, 2),
    )
    return _of_frames(table, twice, np.tile(np.arange(axis.n_frames), 2))


def is_mixed(axis: FrameAxis) -> bool:
    """True if runs are there twice, see :func:`mixed_table`."""
    return any(name.endswith(_BLIND) for name in axis.run_ids)


def seeing_share(axis: FrameAxis) -> float:
    """Share of the weight of the runs in which the VUT may see, see :func:`mixed_table`."""
    is_blind = np.array([name.endswith(_BLIND) for name in axis.run_ids])
    return round(1.0 - float(axis.weight[is_blind].sum() / axis.weight.sum()), 9)


def plain_axis(axis: FrameAxis) -> FrameAxis:
    """Axis with the first level of each run, and the weight of all of them; of runs the same."""
    names = [run_of_level(name) for name in axis.run_ids]
    _, first, run = np.unique(names, return_index=True, return_inverse=True)
    if len(first) == axis.n_runs:
        return axis
    rows = np.sort(first)
    frames = [axis.frames_of(row) for row in rows.tolist()]

    return _of_runs(
        axis,
        rows.tolist(),
        run_ids=tuple(names[row] for row in rows),
        weight=np.bincount(run, weights=axis.weight)[run[rows]].astype(np.float64),
        last_brake_time_s=axis.last_brake_time_s[rows],
        run_start=np.cumsum([0, *(part.stop - part.start for part in frames)]),
        time_s=np.concatenate([axis.time_s[part] for part in frames]),
    )


def _at_once(
    time_s: FloatArray, last_s: float, deadline_s: float, rule: AebRule
) -> tuple[FloatArray, float]:
    """Times of frames that are in time for a level, in its clock, and its last brake time there."""
    n_before = int(is_in_time(time_s, last_s, latency_s=rule.latency_s).sum())
    after = _AT_ONCE_S * np.arange(1, len(time_s) - n_before + 1)
    if last_s == -np.inf:  # no moment comes before
        last_s = deadline_s
        after -= after[-1]
    moment_s = last_s - rule.latency_s
    if n_before:
        moment_s = max(moment_s, float(time_s[n_before - 1]))
    times = np.concatenate([time_s[:n_before], moment_s + after])
    return times, last_s
