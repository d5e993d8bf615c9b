"""What real detectors found.

Recall, its correlation in time, boxes, and frames to confirmation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.calibrations import ground_points
from geometry.opening import read_text
from placement.detectors.evidence import Interval, linked_noise
from placement.detectors.fitting import (
    FalseAlarms,
    ResponseFit,
    Sightings,
    at_frame_rate,
    calibration_error,
    correlation_at,
    fit_response,
    gather_sightings,
    share_by_track,
)
from placement.detectors.response import ResponseDetector, built_in_response
from placement.recordings.formats import RecordedBoxes, read_boxes
from placement.recordings.pairs import PairedBoxes, frames_to_confirm, pair_boxes

from .projection import bottoms, pets_tracks

N_CONFIRMATIONS = 3
# Frame rate that tables' correlations hold for.
TABLE_HZ = 10.0
# The odd ones judge the finished model.
KITTI_SEQUENCES = tuple(range(0, 21, 2))
HEIGHT_EDGES_PX = (0.0, 25.0, 40.0, 60.0, 80.0, 100.0, np.inf)
# Hidden.
SHARE_EDGES = (0.0, 0.01, 0.10, 0.35, 0.80, np.inf)
DISTANCE_EDGES_M = (0.0, 10.0, 20.0, 30.0, 40.0, np.inf)
# Of held-out frames by the table.
_DRAWS = 100
# Numbers kept free for those of a sequence.
_TRACKS = 1000
_SPREAD = (0.025, 0.975)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Watched:
    """A detector on a recording, and how its frames fall into halves."""

    # Of the table.
    name: str
    recording: str
    detector: str
    year: int
    source: str
    frame_rate_hz: float
    # In the order of tracks and frames.
    sightings: Sightings
    # (n,): from the sensor, on the ground.
    distance_m: FloatArray
    # (n, 4): boxes as labelled.
    label_px: FloatArray
    # (n,): KITTI's; -1: the share hidden is that of boxes.
    hidden_level: IntArray
    alarms: FalseAlarms
    # By what divides: rows of the first half.
    halves: Mapping[str, BoolArray]


def watch_pets(folder: Path) -> Watched:
    """Faster R-CNN on PETS; halves by people and by time."""
    given, camera = pets_tracks(folder)
    found = read_boxes(
        folder / "sort" / "data" / "train" / "PETS09-S2L1" / "det" / "det.txt"
    )
    paired = pair_boxes(
        given, found, classes={"pedestrian": "pedestrian"}, min_score=0.5
    )
    ground = ground_points(bottoms(given.box_px), camera)[:, :2] - camera.position_m[:2]
    sightings, alarms, order = _gather(paired, frame_rate_hz=7.0)
    rows = paired.label_index[order]
    return Watched(
        name="pole-2015",
        recording="PETS 2009 S2L1, view 1, annotated in OpenTraj",
        detector="Faster R-CNN, the public detections of MOT15, score >= 0.5",
        year=2015,
        source="crowdbotp/OpenTraj; abewley/sort",
        frame_rate_hz=7.0,
        sightings=sightings,
        distance_m=np.hypot(*ground.T)[rows],
        label_px=given.box_px[rows],
        hidden_level=given.hidden_level[rows],
        alarms=alarms,
        halves={
            "people": given.track[rows] % 2 == 0,
            "time": sightings.frame < 0.5 * given.frame.max(),
        },
    )


def watch_kitti(folder: Path, *, name: str, class_name: str) -> Watched:
    """RRC or PointRCNN on KITTI's even sequences.

    Halves by sequence and by people.

    Nearly all boxes are those of sequence 16: it is a half of its own.
    """
    detector, source, _, year, least = _KITTI[name]
    data = folder / "OpenTraj" / "datasets" / "KITTI" / "data"
    parts: list[PairedBoxes] = []
    labelled: list[RecordedBoxes] = []
    sequence: list[IntArray] = []
    for number in KITTI_SEQUENCES:
        given = read_boxes(data / "label" / f"{number:04d}.txt")
        if not (given.is_class(class_name) & (given.track >= 0)).any():
            continue
        found = kitti_found(folder, name, class_name, number)
        n_frames = len(
            read_text(data / "oxts" / f"{number:04d}.txt", "text").splitlines()
        )
        paired = pair_boxes(
            given,
            found,
            classes={class_name: class_name},
            min_score=least,
            first_track=_TRACKS * number,
            n_frames=n_frames,
        )
        parts.append(paired)
        labelled.append(given.take(paired.label_index))
        sequence.append(np.full(len(paired.label_index), number))
    whole = PairedBoxes(
        pictures=tuple(picture for part in parts for picture in part.pictures),
        label_index=np.arange(sum(len(part.label_index) for part in parts)),
    )
    sightings, alarms, order = _gather(whole, frame_rate_hz=TABLE_HZ)
    place = np.concatenate([one.position_m for one in labelled])[order]
    return Watched(
        name=name,
        recording=f"KITTI tracking, even sequences, {class_name}s",
        detector=detector,
        year=year,
        source=f"crowdbotp/OpenTraj; {source}",
        frame_rate_hz=TABLE_HZ,
        sightings=sightings,
        distance_m=np.hypot(place[:, 0], place[:, 2]),
        label_px=np.concatenate([one.box_px for one in labelled])[order],
        hidden_level=np.concatenate([one.hidden_level for one in labelled])[order],
        alarms=alarms,
        halves={
            "sequence": np.concatenate(sequence)[order] == 16,
            "people": sightings.track % 2 == 0,
        },
    )


_KITTI = {
    "car-2019": (
        "RRC, score >= 0.5, as in DeepFusionMOT",
        "wangxiyang2022/DeepFusionMOT",
        "DeepFusionMOT/data/detections/2D/rrc/training/{}",
        2019,
        0.5,
    ),
    "pointrcnn-2019": (
        "PointRCNN, score >= 0, as in AB3DMOT",
        "xinshuoweng/AB3DMOT",
        "AB3DMOT/data/KITTI/detection/pointrcnn_{}_val",
        2019,
        0.0,
    ),
}


def kitti_found(folder: Path, name: str, class_name: str, number: int) -> RecordedBoxes:
    """What a detector found in one of KITTI's sequences."""
    _, _, path, _, _ = _KITTI[name]
    place = folder / path.format(class_name.capitalize())
    return read_boxes(place / f"{number:04d}.txt")


def _gather(
    paired: PairedBoxes, *, frame_rate_hz: float
) -> tuple[Sightings, FalseAlarms, IntArray]:
    """Sightings by track and frame, false alarms, and the rows' order."""
    sightings, alarms = gather_sightings(
        paired.pictures, n_confirmations=N_CONFIRMATIONS, frame_rate_hz=frame_rate_hz
    )
    order = np.lexsort((sightings.frame, sightings.track))
    return sightings.take(order), alarms, order


@dataclass(frozen=True, slots=True, kw_only=True)
class Recall:
    """Share found among the rows of a group, and what a table predicts of it."""

    words: str
    frames: int
    tracks: int
    measured: Interval
    # Mean probability of the built-in table "response".
    predicted: float

    @property
    def is_off(self) -> bool:
        """True if the prediction lies outside of the interval."""
        return not self.measured.low <= self.predicted <= self.measured.high


def recalls(
    watched: Watched, values: FloatArray, edges: Sequence[float], unit: str
) -> list[Recall]:
    """Recall between edges of some quantity (n,).

    Groups without rows are left out.
    """
    groups = []
    for low, high in pairwise(edges):
        rows = np.flatnonzero((values >= low) & (values < high))
        if high == np.inf:
            words = f"{low:g} {unit} and more"
        else:
            words = f"{low:g} to {high:g} {unit}"
        if len(rows):
            groups.append(recall_of(watched.sightings.take(rows), words))
    return groups


def recall_of(sightings: Sightings, words: str) -> Recall:
    """Recall of all rows."""
    return Recall(
        words=words,
        frames=len(sightings),
        tracks=len(np.unique(sightings.track)),
        measured=share_by_track(sightings.is_found, sightings.track),
        predicted=float(built_in_response().probability(sightings.evidence()).mean()),
    )


def phi(sightings: Sightings) -> Interval:
    """Correlation of detection between consecutive frames.

    With a 95 % interval, by tracks drawn anew.
    """
    same = np.diff(sightings.track) == 0
    is_next = np.flatnonzero(same & (np.diff(sightings.frame) == 1))
    a = sightings.is_found[is_next]
    b = sightings.is_found[is_next + 1]
    _, which = np.unique(sightings.track[is_next], return_inverse=True)
    weights = (np.ones(len(a)), a, b, a & b)
    # (4, n_tracks).
    sums = np.array([np.bincount(which, weights=one) for one in weights])
    n_tracks = sums.shape[1]
    counts = np.random.default_rng(0).multinomial(
        n_tracks, np.full(n_tracks, 1.0 / n_tracks), size=1000
    )
    low, high = np.nanquantile(_phi(sums @ counts.T), _SPREAD).tolist()
    return Interval(float(_phi(sums.sum(axis=1))), low, high)


def _phi(sums: FloatArray) -> FloatArray:
    n, a, b, both = sums
    spread = np.sqrt(a * (n - a) * b * (n - b))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation: FloatArray = (n * both - a * b) / spread
    return correlation


def side_errors(sightings: Sightings) -> tuple[float, float]:
    """Standard deviations of the sides of found boxes, as shares.

    Of left and right, and of upper and lower sides.
    """
    error = sightings.box_error[sightings.is_found]
    spread = error.std(axis=0)
    return float(spread[[0, 2]].mean()), float(spread[[1, 3]].mean())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOut:
    """A table fitted to one half of the frames, judged by the other one."""

    words: str
    # Held out.
    frames: int
    tracks: int
    # Calibration error of recall.
    error: float
    # 97.5 % of the errors that a true table would have by chance.
    chance_error: float
    # Kolmogorov-Smirnov, of frames to confirmation.
    distance: float
    # Share of starts confirmed within 1, 2, .. frames.
    real: FloatArray
    predicted: FloatArray
    # The same by the built-in table "response".
    by_response: FloatArray


_WITHIN = np.arange(1, 101)


def hold_out(watched: Watched, divided_by: str, *, fit_first: bool) -> HeldOut:
    """Fit a table to one half, and predict confirmation in the other.

    They count from every frame of a track on; a track that ends before counts as never.
    """
    rows = watched.halves[divided_by] == fit_first
    seen = watched.sightings
    fit = fit_response(seen.take(np.flatnonzero(rows)), name="half", draws=0)
    held = seen.take(np.flatnonzero(~rows))
    probability = fit.detector.probability(held.evidence())
    drawn = _draw(held, probability, fit.detector.frame_correlation)
    table = built_in_response()
    there = table.probability(held.evidence())
    by_response = _draw(held, there, _correlation_there(table, watched))
    real = _confirmed(held, held.is_found[None])
    predicted = _confirmed(held, drawn)
    chance = [calibration_error(probability, one) for one in drawn]
    return HeldOut(
        words=f"{divided_by}, fitted to the {'first' if fit_first else 'second'} half",
        frames=len(held),
        tracks=len(np.unique(held.track)),
        error=calibration_error(probability, held.is_found),
        chance_error=float(np.quantile(chance, _SPREAD[1])),
        distance=float(np.abs(real - predicted).max()),
        real=real,
        predicted=predicted,
        by_response=_confirmed(held, by_response),
    )


def _correlation_there(table: ResponseDetector, watched: Watched) -> float:
    """A table's correlation at the recording's frame rate."""
    return correlation_at(
        table.frame_correlation, from_hz=TABLE_HZ, to_hz=watched.frame_rate_hz
    )


def _draw(held: Sightings, probability: FloatArray, correlation: float) -> BoolArray:
    """Frames found, drawn some hundred times, (n_draws, n)."""
    from scipy.special import ndtr

    rng = np.random.default_rng(0)
    # A gap between tracks: their draws are not linked.
    numbers = held.frame + (held.track - held.track.min()) * (int(held.frame.max()) + 2)
    rows = [
        ndtr(linked_noise(numbers, correlation, rng)) < probability
        for _ in range(_DRAWS)
    ]
    return np.array(rows)


def _confirmed(held: Sightings, found: BoolArray) -> FloatArray:
    """Share of starts that are confirmed within 1, 2, .

    Frames, over all draws (n_draws, n).
    """
    waits = np.concatenate([_waits(held, one) for one in found])
    within = np.searchsorted(np.sort(waits[waits > 0]), _WITHIN, side="right")
    return within / len(waits)


def confirmed_at_once(watched: Watched) -> Recall:
    """Share of starts whose first three frames confirm.

    The prediction is drawn by "response".
    """
    table = built_in_response()
    sightings = watched.sightings
    waits = _waits(sightings, sightings.is_found)
    probability = table.probability(sightings.evidence())
    drawn = _draw(sightings, probability, _correlation_there(table, watched))
    return Recall(
        words="starts confirmed at once",
        frames=len(sightings),
        tracks=len(np.unique(sightings.track)),
        measured=share_by_track(waits == N_CONFIRMATIONS, sightings.track),
        predicted=float(_confirmed(sightings, drawn)[N_CONFIRMATIONS - 1]),
    )


def _waits(sightings: Sightings, found: BoolArray) -> IntArray:
    return frames_to_confirm(
        found, sightings.track, sightings.frame, n_confirmations=N_CONFIRMATIONS
    )


def first_confirmed(sightings: Sightings) -> tuple[int, int]:
    """Tracks confirmed by their first three frames, and all tracks."""
    waits = _waits(sightings, sightings.is_found)
    first = np.unique(sightings.track, return_index=True)[1]
    return int((waits[first] == N_CONFIRMATIONS).sum()), len(first)


def fit_table(watched: Watched) -> ResponseFit:
    """The table fitted to all frames.

    Its correlation is that at the tables' frame rate.
    """
    fit = fit_response(watched.sightings, name=watched.name)
    return at_frame_rate(fit, from_hz=watched.frame_rate_hz, to_hz=TABLE_HZ)
