"""Detection table: which candidate pose detects the VRU in which frame.

V[c, f] is stored as bits.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.errors import refuse
from scenarios.runs import FrameAxis


# Held weakly: it is part of many fingerprints.
@dataclass(frozen=True, slots=True, weakref_slot=True, kw_only=True, eq=False)
class DetectionTable:
    """Detections of every candidate pose in every frame.

    Attributes
    ----------
    pose_ids : tuple of str
        Ids of the candidate poses: the rows.
    axis : FrameAxis
        Runs and frames: the columns.
    packed : (n_poses, ceil(n_frames / 8)) uint8
        Bits along the frames, lowest bit first (``numpy.packbits(...,
        bitorder="little")``).
    """

    pose_ids: tuple[str, ...]
    axis: FrameAxis
    packed: NDArray[np.uint8]

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


# ---------- runs by their frames
# Unpacked at a time.
_ROWS = 256
_BLIND = " (blind)"


def _of_frames(
    table: DetectionTable, axis: FrameAxis, frames: IntArray
) -> DetectionTable:
    """Table whose columns are some frames of another one."""
    packed = np.empty((table.n_poses, -(-axis.n_frames // 8)), dtype=np.uint8)
    # Blocks of rows are unpacked at a time, to bound the memory.
    for row in range(0, table.n_poses, _ROWS):
        bits = table.detected(slice(row, row + _ROWS))[:, frames]
        packed[row : row + _ROWS] = np.packbits(bits, axis=1, bitorder="little")
    return DetectionTable(pose_ids=table.pose_ids, axis=axis, packed=packed)


def _of_runs(axis: FrameAxis, rows: Sequence[int], **changes: Any) -> FrameAxis:
    """Axis whose runs are some rows of another one, with changes.

    Case, approach, position, weather and speed are those of the rows.
    """
    words = {
        name: tuple(getattr(axis, name)[row] for row in rows)
        for name in ("cases", "approaches", "positions", "weathers")
    }
    return replace(
        axis, vut_speed_kmh=axis.vut_speed_kmh[list(rows)], **(words | changes)
    )


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
    # Starts of the runs of each repetition, shifted by the frames before it.
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
    """Table with every run twice: by a VUT that sees, and by a blind one.

    `share` of the weight is the first one's. Ids of runs that are driven by a VUT
    that does not see end in " (blind)".
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
    """Share of the weight of runs whose VUT may see.

    See :func:`mixed_table`.
    """
    is_blind = np.array([name.endswith(_BLIND) for name in axis.run_ids])
    return round(1.0 - float(axis.weight[is_blind].sum() / axis.weight.sum()), 9)


def plain_run(run_id: str) -> str:
    """Id of a run, whichever VUT drives it: see :func:`mixed_table`."""
    return run_id.removesuffix(_BLIND)


def plain_axis(axis: FrameAxis) -> FrameAxis:
    """Axis with each run once, and the weight of both.

    An axis without runs that are there twice is returned as it is.
    """
    names = [plain_run(name) for name in axis.run_ids]
    _, first, run = np.unique(names, return_index=True, return_inverse=True)
    if len(first) == axis.n_runs:
        return axis
    # Rows where each run is for the first time, in the order of the axis.
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
