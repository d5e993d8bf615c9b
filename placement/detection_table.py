"""Which candidate pose detects the VRU in which frame: V[c, f], as bits."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, freeze
from geometry.errors import InputError, Unquoted
from scenarios.runs import FrameAxis


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DetectionTable:
    """Detections of every candidate pose in every frame.

    Attributes
    ----------
    pose_ids : tuple of str
        Ids of the candidate poses: the rows.
    axis : FrameAxis
        Runs and frames: the columns.
    packed : (n_poses, ceil(n_frames / 8)) uint8
        Bits along the frames, lowest bit first (``numpy.packbits(..., bitorder="little")``).
    """

    pose_ids: tuple[str, ...]
    axis: FrameAxis
    packed: NDArray[np.uint8]

    def __post_init__(self) -> None:
        packed = np.array(self.packed, dtype=np.uint8)
        shape = (len(self.pose_ids), -(-self.axis.n_frames // 8))
        if packed.shape != shape:
            raise InputError("packed", Unquoted(f"shape {packed.shape}"), f"shape {shape}")
        object.__setattr__(self, "packed", freeze(packed))

    @property
    def n_poses(self) -> int:
        """Number of candidate poses."""
        return len(self.pose_ids)

    def detected(self, pose_index: "NDArray[np.int64] | list[int] | slice") -> BoolArray:
        """Rows of the table, unpacked: V[c, f], (n, n_frames) bool."""
        bits = np.unpackbits(
            self.packed[pose_index], axis=1, count=self.axis.n_frames, bitorder="little"
        )
        return bits.astype(bool)

    def __repr__(self) -> str:
        return f"DetectionTable({self.n_poses} poses, {self.axis.n_frames} frames)"


def pack_table(pose_ids: tuple[str, ...], axis: FrameAxis, detected: BoolArray) -> DetectionTable:
    """Detection table from an array of booleans, (n_poses, n_frames)."""
    return DetectionTable(
        pose_ids=pose_ids, axis=axis, packed=np.packbits(detected, axis=1, bitorder="little")
    )
