"""What a detector misses by chance, frame by frame, and which messages are lost."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import ndtr
from threadpoolctl import threadpool_limits

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.lidar import LidarModel

from ..candidates import CandidatePose
from ..detection_table import DetectionTable
from ..detectors import Evidence, PlanningDetector, ResponseDetector
from ..evaluator.surroundings import draw_index
from ..visibility.build import N_POINTS
from ..visibility.casting import World, build_world, cast_sight
from ..visibility.sensing import build_sensing, reach_m
from .luck import Luck, pose_key
from .samples import Sample

Progress = Callable[[int, int], None]


def build_drawn_table(
    sample: Sample,
    detector: ResponseDetector,
    *,
    seed: int,
    workers: int,
    on_progress: Progress | None = None,
) -> DetectionTable:
    """Detection table of a sampled world in which chance decides every frame of a camera.

    Parameters
    ----------
    sample : Sample
        The world.
    detector : ResponseDetector
        Gives the probabilities. Boxes are not drawn: they are near enough to match.
    seed : int
        Of the points on the VRUs.
    workers : int
        Threads.
    on_progress : callable, optional
        Called with mount positions done and their number.

    Returns
    -------
    table : DetectionTable
        V[c, f]. The luck of a pose does not depend on the others, and is one and the same in all
        weathers; from frame to frame it is linked as in the evaluator. A LiDAR counts the points
        that it may expect.
    """
    setting = sample.setting
    world = build_world(setting.scene, setting.runs, n_points=N_POINTS, seed=seed)
    groups: dict[tuple[float, ...], list[int]] = {}
    for row, candidate in enumerate(sample.candidates):
        key = (*candidate.pose.position_m.tolist(), candidate.sensor.near_m)
        groups.setdefault(key, []).append(row)
    links = link_frames(draw_index(setting.runs))
    packed = np.zeros((len(sample.candidates), -(-setting.axis.n_frames // 8)), dtype=np.uint8)

    def fill(rows: list[int]) -> None:
        likely = _probabilities(world, [sample.candidates[row] for row in rows], detector)
        for row, probability in zip(rows, likely, strict=True):
            seen: BoolArray = probability > 0.0
            planned = sample.planned[row]
            if seen.any() and not isinstance(planned.sensor, LidarModel):
                rng = sample.luck.rng("detector", *pose_key(planned))
                noise = links.noise(detector.frame_correlation, rng)[seen]
                seen[seen] = ndtr(noise) < probability[seen]
            packed[row] = np.packbits(seen, bitorder="little")

    with threadpool_limits(1), ThreadPoolExecutor(workers) as pool:
        pending = [pool.submit(fill, rows) for rows in groups.values()]
        try:
            for done, future in enumerate(as_completed(pending), start=1):
                future.result()
                if on_progress is not None:
                    on_progress(done, len(pending))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return DetectionTable(
        pose_ids=tuple(candidate.id for candidate in sample.candidates),
        axis=setting.axis,
        packed=packed,
    )


def lose_messages(sample: Sample, table: DetectionTable) -> DetectionTable:
    """A table without the detections whose messages are lost.

    Parameters
    ----------
    sample : Sample
        The world: its share of lost messages, its luck.
    table : DetectionTable
        Its rows are the poses of the sample.

    Returns
    -------
    table : DetectionTable
        Each pose loses its messages by itself; in all weathers the same ones.
    """
    loss = sample.setting.links.packet_loss
    if loss == 0.0:
        return table
    draws, frame_draw = np.unique(draw_index(sample.setting.runs), return_inverse=True)
    packed = np.array(table.packed)
    for row in np.flatnonzero(packed.any(axis=1)).tolist():
        luck = sample.luck.rng("message", *pose_key(sample.planned[row]))
        arrives = luck.random(len(draws), dtype=np.float32) >= loss
        packed[row] &= np.packbits(arrives[frame_draw], bitorder="little")
    return DetectionTable(pose_ids=table.pose_ids, axis=table.axis, packed=packed)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameLinks:
    """Which frames share their luck, and which follow one another.

    Attributes
    ----------
    is_frame : (n_runs, longest) bool
        Runs side by side, the same run in several weathers once; the rest of a row is empty.
    index : (n_frames,) int
        Which of its true entries each frame is.
    """

    is_frame: BoolArray
    index: IntArray

    def noise(self, correlation: float, rng: np.random.Generator) -> FloatArray:
        """Standard normal numbers, each linked to that of the frame before.

        Parameters
        ----------
        correlation : float
            Of one frame with the next, 0 .. 1.
        rng : numpy.random.Generator
            Of the draws.

        Returns
        -------
        noise : (n_frames,) float
            A first-order autoregression in each run.
        """
        fresh = rng.standard_normal(self.is_frame.shape)
        step = np.sqrt(1.0 - correlation**2)
        if step == 0.0:
            linked = np.repeat(fresh[:, :1], fresh.shape[1], axis=1)
        else:
            fresh[:, 0] /= step  # the first one stands for all that came before
            linked = lfilter([step], [1.0, -correlation], fresh, axis=1)
        noise: FloatArray = linked[self.is_frame][self.index]
        return noise


def link_frames(frames: IntArray) -> FrameLinks:
    """Find out which frames belong together.

    Parameters
    ----------
    frames : (n_frames,) int
        Numbers, see :func:`placement.evaluator.surroundings.draw_index`: equal ones share their
        luck, those that follow one another are linked.
    """
    draws, index = np.unique(frames, return_inverse=True)
    starts = np.flatnonzero(np.diff(draws, prepend=draws[0] - 2) != 1)
    lengths = np.diff(np.append(starts, len(draws)))
    return FrameLinks(is_frame=np.arange(lengths.max()) < lengths[:, None], index=index)


class _Listener:
    """Stands where the detector is asked whether to expect something, and keeps how likely it is.

    What it is asked by, :class:`placement.visibility.sensing.Sensing`, knows entries: views that
    many frames share. Chance is a matter of frames, and is drawn later.
    """

    def __init__(self, detector: ResponseDetector) -> None:
        self._detector = detector
        self.heard: list[tuple[IntArray, FloatArray]] = []

    def is_expected(self, evidence: Evidence) -> BoolArray:
        """Rows that are not out of the question, (n,)."""
        probability = self._detector.probability(evidence)
        self.heard.append((evidence.draw_index, probability))
        return probability > 0.0


def _probabilities(
    world: World, candidates: Sequence[CandidatePose], detector: ResponseDetector
) -> "list[NDArray[np.float64]]":
    """Probability of a detection in every frame, of all candidates of one mount position."""
    position_m, near_m = candidates[0].pose.position_m, candidates[0].sensor.near_m
    sight = cast_sight(
        world,
        position_m,
        near_m=near_m,
        max_distance_m=max(reach_m(c.sensor, detector, world) for c in candidates),
    )
    listener = _Listener(detector)
    # Of a planning detector, sensing only asks what the listener answers.
    sensing = build_sensing(world, sight, position_m, cast(PlanningDetector, listener))
    found = []
    for candidate in candidates:
        listener.heard.clear()
        # One more entry, of no probability, for frames in which nothing is seen (index -1).
        by_entry = np.zeros((len(world.views.weathers), len(sight.view_index) + 1))
        by_entry[:, :-1] = sensing.detected(candidate)  # of a LiDAR that is all there is
        for in_weather, (entries, probability) in zip(by_entry, listener.heard, strict=False):
            in_weather[entries] = probability
        found.append(by_entry[world.views.weather_of_frame, sight.entry_of_frame])
    return found


def drawing_key(luck: Luck, detector: ResponseDetector) -> str:
    """What a drawn table depends on beside the probabilities."""
    return f"{luck.seed} {luck.purpose} {luck.index} {detector.frame_correlation!r}"
