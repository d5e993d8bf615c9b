"""``place-rsus detector fit``: a response table from real detections.

Sources: a network that looks at rendered pictures, a recording in the study's format,
and files of labels and results, of COCO or of recordings in the formats of others. Each
gives labelled pictures; what follows is the same.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray
from geometry.errors import InputError, refuse
from geometry.image_boxes import box_height_px, iou
from geometry.scene_sources import load_scene
from geometry.sensors import CameraModel
from geometry.tables import read_table
from placement.compute import Compute
from placement.detectors import VRU_CLASSES, Evidence, load_detector
from placement.detectors.evidence import Interval
from placement.detectors.fitting import (
    FalseAlarms,
    Group,
    LabelledPicture,
    ResponseFit,
    at_frame_rate,
    fit_response,
    gather_sightings,
    of_classes,
)
from placement.detectors.network import (
    VRU_KINDS,
    ImageBoxes,
    NetworkDetector,
    boxes_of_class,
    kind_of_name,
)
from placement.evaluator import build_surroundings, load_vut_camera
from placement.evaluator.perceive import perceive_frames
from placement.evaluator.pictures import RenderedPictures
from placement.evaluator.surroundings import FrameCamera
from placement.layout import Layout, check_layout
from placement.question import Question
from placement.recordings import Recording, load_format, read_boxes, read_recording
from placement.recordings.files import Box, json_of
from placement.recordings.formats import COCO, MOT_FILES, MOT_FOLDER, find_format
from placement.recordings.pairs import pair_boxes
from placement.setting import Setting, build_rule, build_setting

from ..export.json import to_json_text
from ..language import mark
from ..progress import StageProgress
from ..results.drives import versions
from ..results.folders import expect_files, save_files
from ..results.record import Record
from ..results.tables import page_of
from .dataset import MANIFEST, load_manifest

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from placement.evaluator.picture_sources import PictureOfFrame
    from placement.evaluator.pictures import RenderedCrops

LOOK = "look"
FIT = "fit"
TABLE_NAME = "response.toml"
JSON_NAME = "fit.json"
PNG_NAME = "calibration.png"

# Consecutive frames: enough to see what carries over, and false tracks.
_BLOCK = 5
# of a network that looks at crops, every so many blocks are whole pictures, too
_WHOLE = 5
_MAX_BYTES = 2**30
_PEDESTRIAN = VRU_CLASSES.index("pedestrian")
_CYCLIST = VRU_CLASSES.index("cyclist")
_FROM_THE_SIDE_DEG = 90.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FitWish:
    """Source of a response table: exactly one."""

    # whose cameras, and the VUT's, show rendered pictures to the question's network
    layout: Layout | None = None
    # How many of these.
    pictures: int = 1000
    # folder in the study's format, with labels and detections
    recording: Path | None = None
    # labels, results: files of annotations and of detections, of COCO or of recordings
    labels: Path | None = None
    results: Path | None = None
    # Of recordings; by default that of runs.
    frame_rate_hz: float | None = None
    # Boxes below do not count.
    min_confidence: float = 0.5
    # Of VRU_CLASSES: those that the detector reports; by default as results show.
    classes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Source:
    """Labelled pictures, what they are, and what they do not tell."""

    words: str
    pictures: Iterator[LabelledPicture]
    unknown: tuple[str, ...] = ()
    # Classes that the detector reports, as far as its results show.
    reported: frozenset[str] = frozenset(VRU_CLASSES)


class FitResult(Record, frozen=True, kw_only=True):
    """Fitted table, recall by group, false alarms.

    ``fit.json``, and what ``--json`` prints.
    """

    # Of the table.
    name: str
    # What was looked at, in words.
    source: str
    # With a road user.
    frames: int
    # Of these, those in which it was found.
    found: int
    # Cameras and runs that the frames are of.
    tracks: int
    # What the source does not say, and is as in the built-in table.
    unknown: tuple[str, ...]
    # Labels of classes that the detector does not report, which are not fitted.
    not_reported: Mapping[str, int]
    table: Mapping[str, Interval]
    groups: Mapping[str, tuple[Group, ...]]
    calibration: tuple[Group, ...]
    false_alarms: FalseAlarms
    command: str
    seconds: dict[str, float]
    versions: dict[str, str]


_OF_FIT = ("frames", "found", "tracks", "groups", "calibration")


def run_detector_fit(
    question: Question,
    *,
    wish: FitWish,
    out: Path | None,
    command: str,
    compute: Compute,
    progress: StageProgress,
) -> FitResult:
    """Fit a response table to what a detector finds.

    Table, figure and numbers to `out`.

    Parameters
    ----------
    question : Question
        What is driven where pictures are rendered, and the network; how many frames
        confirm.
    wish : FitWish
        The source.
    out : Path, optional
        Folder that gets ``response.toml``, ``fit.json`` and ``calibration.png``.
    command : str
        How this was called.
    compute : Compute
        Seed of the choice of pictures, of noise and of the bootstrap; threads.
    progress : StageProgress
        Is given the stages.

    Raises
    ------
    InputError
        A source is not what it should be, there are too few frames, or `out` cannot be
        written.
    """
    expect_files(out, progress)
    source = _open_source(question, wish, compute, progress)
    rule = build_rule(question)
    frame_rate_hz = wish.frame_rate_hz or rule.frame_rate_hz
    reported = wish.classes or source.reported or VRU_CLASSES
    not_reported: Counter[str] = Counter()
    sightings, alarms = gather_sightings(
        of_classes(source.pictures, reported, not_reported),
        n_confirmations=rule.n_confirmations,
        frame_rate_hz=frame_rate_hz,
    )
    fit = fit_response(
        sightings,
        name=TABLE_NAME if out is None else str(out / TABLE_NAME),
        seed=compute.seed,
        progress=lambda done, total: progress(FIT, done, total),
    )
    fit = at_frame_rate(fit, from_hz=frame_rate_hz, to_hz=rule.frame_rate_hz)
    unknown = source.unknown
    if not fit.is_contrast_fitted and "contrast" not in unknown:
        unknown = (*unknown, "contrast")
    unknown = (*unknown, *sorted(not_reported))
    result = FitResult(
        name=fit.detector.name,
        source=source.words,
        unknown=unknown,
        not_reported=dict(sorted(not_reported.items())),
        table=fit.intervals,
        false_alarms=alarms,
        **{key: getattr(fit, key) for key in _OF_FIT},
        command=command,
        seconds={},
        versions=versions(),
    )

    def contents(done: FitResult) -> dict[str, str | bytes]:
        from ..figures.axes import to_png

        head = {"source": source.words, "command": command}
        per_hour = alarms.per_hour
        table = table_text(fit, unknown=unknown, false_tracks_per_hour=per_hour, **head)
        png = to_png(plot_calibration(done))
        return {TABLE_NAME: table, PNG_NAME: png, JSON_NAME: to_json_text(done)}

    return save_files(result, out, progress, contents)


def _open_source(
    question: Question, wish: FitWish, compute: Compute, progress: StageProgress
) -> _Source:
    if wish.recording is not None:
        progress(mark("read"), 0, 0)
        if find_format(wish.recording) == MOT_FOLDER:
            labels, results = (wish.recording / name for name in MOT_FILES)
            return _from_boxes(labels, results, wish.min_confidence)
        _refuse_rule(wish.recording)
        recording = read_recording(wish.recording)
        return _Source(
            words=f"the detections of {recording.folder}, {recording.n_frames} frames",
            pictures=_recorded_pictures(recording, wish.min_confidence),
            unknown=("share that is seen", "contrast", "aspect"),
            reported=_classes_of(_recorded_kinds(recording)),
        )
    if wish.labels is not None and wish.results is not None:
        progress(mark("read"), 0, 0)
        read = _from_coco if find_format(wish.labels) == COCO else _from_boxes
        return read(wish.labels, wish.results, wish.min_confidence)
    assert wish.layout is not None
    return _from_network(question, wish.layout, wish, compute, progress)


def _refuse_rule(folder: Path) -> None:
    """Refuse a folder that ``dataset`` has filled with the detections of a rule.

    A table that is fitted to them says what the rule says.
    """
    manifest = folder / MANIFEST
    if manifest.is_file():
        refuse(
            str(manifest),
            f"detections of {load_manifest(manifest).detector}, a built-in rule",
            f"those of a real detector: write them into {load_format().eval_folder} "
            f"and take {MANIFEST} away",
        )


def _from_network(
    question: Question,
    layout: Layout,
    wish: FitWish,
    compute: Compute,
    progress: StageProgress,
) -> _Source:
    network = load_detector(question.detector, where="--detector")
    if not isinstance(network, NetworkDetector):
        raise InputError(
            "--detector",
            question.detector,
            "cnn, or an .onnx file, whose table is fitted",
        )
    progress(mark("setting"), 0, 0)
    setting = build_setting(question, load_scene(question.scene), compute=compute)
    check_layout(layout, setting.scene)
    words = (
        f"{network.name} on up to {wish.pictures} rendered pictures by the cameras of"
        f" {layout.name} and the VUT's, of {len(setting.runs)} runs at"
        f" {setting.scene.name}"
    )
    return _Source(
        words=words,
        pictures=_look(setting, layout, network, wish, compute, progress),
        reported=network.known_classes,
    )


def _look(
    setting: Setting,
    layout: Layout,
    network: NetworkDetector,
    wish: FitWish,
    compute: Compute,
    progress: StageProgress,
) -> Iterator[LabelledPicture]:
    """Pictures of blocks of consecutive frames, drawn at random.

    As many by each camera.
    """
    surroundings = build_surroundings(setting.scene, setting.runs)
    source = RenderedPictures(setting.scene, setting.runs, seed=compute.seed)
    least_px = network.min_box_height_px
    by_crops = network.looks_at_crops
    views: list[tuple[Evidence, PictureOfFrame, RenderedCrops | None]] = []
    cameras: list[FrameCamera] = [
        (unit.pose, unit.sensor)
        for unit in layout.units
        if isinstance(unit.sensor, CameraModel)
    ]
    cameras.append(load_vut_camera())
    for number, camera in enumerate(cameras):
        progress(mark("label"), number, len(cameras))
        evidence = perceive_frames(surroundings, camera, min_height_px=least_px)
        if by_crops:
            crops = source.crops(camera, evidence.amodal_px)
        else:
            crops = None
        views.append((evidence, source.pictures(camera), crops))
    rng = np.random.default_rng([compute.seed, len(views)])
    shares = _share_out(
        wish.pictures,
        [int((box_height_px(one.visible_px) > 0.0).sum()) for one, *_ in views],
    )
    n_drawn = 0
    for number, (evidence, picture, crops) in enumerate(views):
        picked = _pick_frames(setting, evidence, shares[number], rng)
        in_crops: dict[int, ImageBoxes] = {}
        for row, crop in (
            () if crops is None else crops.draw_all([row for *_, row in picked])
        ):
            progress(LOOK, n_drawn + len(in_crops), sum(shares))
            in_crops[row] = network.look_at(crop)
        for run, frame, row in picked:
            progress(LOOK, n_drawn, sum(shares))
            n_drawn += 1
            # An evaluation counts boxes that are found in the crop.
            in_crop = in_crops.get(row)
            is_whole = in_crop is None or n_drawn // _BLOCK % _WHOLE == 0
            if in_crop is None or is_whole:
                found = network.look(picture(row))
            else:
                found = in_crop
            is_sure = found.confidence >= wish.min_confidence
            kind = int(np.broadcast_to(evidence.vru_class, len(evidence))[row])
            of_class, how_sure = boxes_of_class(in_crop or found, VRU_CLASSES[kind])
            box = evidence.visible_px[row]
            # Boxes on a road user that is too small to count are no false alarms.
            # Nor are those on cars: the pictures are full of them.
            counted = [one for one, name in found.kinds.items() if name in VRU_KINDS]
            is_alone = np.isin(found.class_ids, counted) & (
                iou(found.boxes_px, box) == 0
            )
            n_labels = int(box[3] - box[1] >= max(least_px, 1.0))
            yield LabelledPicture(
                track=number * len(setting.runs) + run,
                frame=frame,
                label_px=box[None][:n_labels],
                label_class=np.full(n_labels, kind),
                seen_share=_row(
                    evidence.visible_share * evidence.inside_share, row, n_labels
                ),
                contrast=_row(evidence.contrast, row, n_labels),
                aspect_deg=_row(evidence.aspect_deg, row, n_labels),
                found_px=of_class[how_sure >= wish.min_confidence],
                alone_px=found.boxes_px[is_sure & is_alone],
                is_whole=is_whole,
            )


def _share_out(n_wanted: int, n_there: Sequence[int]) -> list[int]:
    """How many of each; as even as those allow that have few."""
    shares = [0] * len(n_there)
    left = n_wanted
    order = sorted(range(len(n_there)), key=lambda index: n_there[index])
    for done, index in enumerate(order):
        shares[index] = min(n_there[index], left // (len(order) - done))
        left -= shares[index]
    return shares


def _row(values: FloatArray, row: int, n_labels: int) -> FloatArray:
    """Value of a row of evidence, which may have one for all.

    Nothing if there is no label.
    """
    return np.atleast_1d(values)[[row if len(np.atleast_1d(values)) > 1 else 0]][
        :n_labels
    ]


def _pick_frames(
    setting: Setting, evidence: Evidence, n_wanted: int, rng: np.random.Generator
) -> list[tuple[int, int, int]]:
    """Run, frame and row of blocks of consecutive frames.

    They begin where the road user is large enough.
    """
    chosen: dict[int, tuple[int, int, int]] = {}
    for row in rng.permutation(
        np.flatnonzero(box_height_px(evidence.visible_px) > 0.0)
    ).tolist():
        if len(chosen) >= n_wanted:
            break
        run = int(np.searchsorted(setting.axis.run_start, row, side="right")) - 1
        frames = setting.axis.frames_of(run)
        for other in range(row, min(row + _BLOCK, frames.stop)):
            chosen[other] = (run, other - frames.start, other)
    return [chosen[row] for row in sorted(chosen)][:n_wanted]


def _recorded_pictures(
    recording: Recording, min_confidence: float
) -> Iterator[LabelledPicture]:
    names = [
        *recording.units,
        *([load_format().vut_folder] if recording.has_vut else []),
    ]
    for number, name in enumerate(names):
        all_labels = recording.labels[name]
        all_found = recording.detections[name]
        for index, drive in enumerate(recording.drives):
            for frame, key in enumerate(drive.frames):
                yield _plain_picture(
                    number * len(recording.drives) + index,
                    frame,
                    labels=[
                        (one.box_px, _RECORDED[one.class_name], 1.0)
                        for one in all_labels.get(key, ())
                        if one.class_name in _RECORDED
                    ],
                    found=[
                        (one.box_px, one.class_name == "pedestrian")
                        for one in all_found.get(key, ())
                        if one.confidence >= min_confidence
                        and one.class_name in _RECORDED
                    ],
                )


def _recorded_kinds(recording: Recording) -> set[str]:
    """Classes of a recording's detections."""
    return {
        one.class_name
        for of_frame in recording.detections.values()
        for found in of_frame.values()
        for one in found
    }


def _classes_of(names: Iterable[str]) -> frozenset[str]:
    """Classes of road users that results of these classes are of.

    Who reports people reports children; empty: nothing is reported at all.
    """
    classes: set[str] = set()
    for name in names:
        classes.update(_REPORTED.get(name, ()))
    return frozenset(classes)


_REPORTED = {
    "person": ("pedestrian", "child"),
    "pedestrian": ("pedestrian", "child"),
    "bicycle": ("cyclist",),
    "cyclist": ("cyclist",),
    "car": ("car",),
}
_RECORDED = {"pedestrian": _PEDESTRIAN, "bicycle": _CYCLIST}


def _plain_picture(
    track: int,
    frame: int,
    *,
    labels: Sequence[tuple[Box, int, float]],
    found: Sequence[tuple[Box, bool]],
) -> LabelledPicture:
    """A picture of which neither contrast nor aspect is known.

    `labels` have a box, a class and the share that is seen; `found` a box, and if it is
    a person's. A rider may be found as a person, as the study's evaluation allows.
    """
    kinds = np.array([kind for _, kind, _ in labels], dtype=np.int64)
    is_person = np.array([one for _, one in found], dtype=bool)
    return LabelledPicture(
        track=track,
        frame=frame,
        label_px=np.array([box for box, _, _ in labels], dtype=np.float64).reshape(
            -1, 4
        ),
        label_class=kinds,
        seen_share=np.array([share for _, _, share in labels], dtype=np.float64),
        contrast=np.ones(len(labels)),
        aspect_deg=np.full(len(labels), _FROM_THE_SIDE_DEG),
        found_px=np.array([box for box, _ in found], dtype=np.float64).reshape(-1, 4),
        finds=(kinds[:, None] == _CYCLIST) | is_person,
    )


_FOUND_CLASSES = ("pedestrian", "cyclist")


def _from_boxes(labels: Path, results: Path, min_score: float) -> _Source:
    annotated = read_boxes(labels)
    found = read_boxes(results)
    classes = {name: name for name in _FOUND_CLASSES if annotated.is_class(name).any()}
    paired = pair_boxes(annotated, found, classes=classes, min_score=min_score)
    left_out = "".join(f" without {n} {what}" for what, n in annotated.left_out.items())
    words = f"{results} on the {len(paired.pictures)} frames of {labels}{left_out}"
    return _Source(
        words=words,
        pictures=iter(paired.pictures),
        unknown=("contrast", "aspect"),
        reported=_classes_of(set(found.class_name)),
    )


class _Image(msgspec.Struct, frozen=True):
    id: int
    run: str = ""
    frame: int = 0
    file_name: str = ""


class _Category(msgspec.Struct, frozen=True):
    id: int
    name: str


_CornerAndSize = tuple[
    float, float, Annotated[float, Meta(ge=0)], Annotated[float, Meta(ge=0)]
]


class _Boxed(msgspec.Struct, frozen=True):
    image_id: int
    category_id: int
    bbox: _CornerAndSize

    @property
    def corners_px(self) -> Box:
        left, top, width, height = self.bbox
        return left, top, left + width, top + height


class _Annotation(_Boxed, frozen=True):
    iscrowd: int = 0
    visible_share: Annotated[float, Meta(ge=0, le=1.000001)] | None = None


class _Result(_Boxed, frozen=True):
    score: Annotated[float, Meta(ge=0, le=1)]


class _Labels(msgspec.Struct, frozen=True):
    images: tuple[_Image, ...]
    annotations: tuple[_Annotation, ...]
    categories: tuple[_Category, ...]


def _from_coco(labels_path: Path, results_path: Path, min_confidence: float) -> _Source:
    labels = read_table(
        json_of(labels_path, max_bytes=_MAX_BYTES), _Labels, str(labels_path)
    )
    found = json_of(results_path, max_bytes=_MAX_BYTES)
    results = read_table(found, tuple[_Result, ...], str(results_path))
    known_names = {
        name: kind for name, kind in kind_of_name().items() if kind in VRU_KINDS
    }
    kinds = {one.id: known_names.get(one.name.lower()) for one in labels.categories}
    if not any(kinds.values()):
        got = ", ".join(one.name for one in labels.categories) or "none"
        refuse(
            f"{labels_path}: categories",
            got,
            "among them one of " + ", ".join(sorted(known_names)),
        )
    known = {image.id for image in labels.images}
    for path, rows in ((labels_path, labels.annotations), (results_path, results)):
        stray = next((row.image_id for row in rows if row.image_id not in known), None)
        if stray is not None:
            raise InputError(f"{path}: image_id", stray, f"an image of {labels_path}")
    shares = [one.visible_share for one in labels.annotations]
    unknown = () if shares and None not in shares else ("share that is seen",)
    return _Source(
        words=f"{results_path} on the {len(known)} pictures of {labels_path}",
        pictures=_coco_pictures(labels, results, kinds, min_confidence),
        unknown=(*unknown, "contrast", "aspect"),
        reported=_classes_of({kinds.get(one.category_id) or "" for one in results}),
    )


def _coco_pictures(
    labels: _Labels,
    results: Sequence[_Result],
    kinds: dict[int, str | None],
    min_confidence: float,
) -> Iterator[LabelledPicture]:
    of_image: dict[int, tuple[list[_Annotation], list[_Result]]] = {
        image.id: ([], []) for image in labels.images
    }
    for label in labels.annotations:
        if kinds.get(label.category_id) and not label.iscrowd:
            of_image[label.image_id][0].append(label)
    for one in results:
        if kinds.get(one.category_id) and one.score >= min_confidence:
            of_image[one.image_id][1].append(one)
    tracks: dict[tuple[object, ...], int] = {}
    for image in sorted(
        labels.images, key=lambda image: (image.run, image.file_name, image.id)
    ):
        # Pictures of no run are tracks of their own.
        key = (image.run, Path(image.file_name).parent) if image.run else (image.id,)
        labels_here, found = of_image[image.id]
        yield _plain_picture(
            tracks.setdefault(key, len(tracks)),
            image.frame,
            labels=[
                (
                    one.corners_px,
                    _PEDESTRIAN if kinds[one.category_id] == "person" else _CYCLIST,
                    1.0 if one.visible_share is None else min(one.visible_share, 1.0),
                )
                for one in labels_here
            ],
            found=[
                (one.corners_px, kinds[one.category_id] == "person") for one in found
            ],
        )


_KEYS_OF = {
    "aspect": ("cyclist_end_on",),
    "contrast": ("contrast_half", "contrast_steepness"),
    "frame_correlation": ("frame_correlation",),
    "cyclist": ("cyclist_end_on",),
}
"""By what a source does not say, the keys whose figures are the built-in ones."""
_FIGURES = (
    *("height_half_px", "height_steepness", "min_box_height_px", "cyclist_end_on"),
    *("contrast_half", "contrast_steepness", "box_noise_share", "frame_correlation"),
)


def table_text(
    fit: ResponseFit,
    *,
    source: str,
    command: str,
    unknown: Sequence[str],
    false_tracks_per_hour: Interval | None,
) -> str:
    """The table as TOML, for ``--detector FILE``.

    Each figure with its 95 % interval.
    """
    table = fit.detector
    intervals = fit.intervals
    of_unknown = {key for what in unknown for key in _KEYS_OF.get(what, ())}
    figures = sorted(of_unknown)
    assumed = {*figures, *table.assumed}

    def said(key: str, *names: str) -> str:
        ranges = [
            intervals[name]
            for name in names
            if intervals[name].low < intervals[name].high
        ]
        words = ", ".join(f"{one.low:.3g} to {one.high:.3g}" for one in ranges)
        if ranges:
            return f"95 %: {words}"
        if key in assumed:
            return "assumption"
        return ""

    recall = [round(value, 6) for value in table.recall.tolist()]
    return page_of(
        files(__package__) / "response.toml.j2",
        fit=fit,
        table=table,
        source=source,
        command=command,
        unknown=unknown,
        seen_share=[round(value, 6) for value in table.seen_share.tolist()],
        recall=recall,
        classes=list(zip(VRU_CLASSES, table.class_factor.tolist(), strict=True)),
        assumed=msgspec.json.encode(table.assumed).decode(),
        assumed_figures=msgspec.json.encode(figures).decode(),
        per_hour=false_tracks_per_hour,
        words={
            "recall": said(
                "recall", *(f"recall[{index}]" for index in range(len(recall)))
            ),
            **{key: said(key, key) for key in (*_FIGURES, *VRU_CLASSES)},
            "plan_probability": "assumption",
        },
    )


def plot_calibration(result: FitResult) -> "Figure":
    """Share found, by predicted probability and by height in the image.

    With 95 % intervals.

    Parameters
    ----------
    result : DetectorFitResult
        What was fitted.

    Returns
    -------
    figure : Figure
        Two pairs of axes.
    """
    from ..figures.axes import BLUE, GREY, WIDTH_IN, finish_axes, new_figure

    figure = new_figure(WIDTH_IN, 3.2)
    left, right = figure.subplots(1, 2)
    left.plot([0.0, 1.0], [0.0, 1.0], color=GREY, linestyle="--", linewidth=1.0)
    look = {"fmt": "o", "color": BLUE, "markersize": 4, "capsize": 2}
    calibrated = [group.recall for group in result.calibration]
    draw_intervals(
        left, [group.expected for group in result.calibration], calibrated, **look
    )
    left.set_xlim(0.0, 1.0)
    finish_axes(left, x="probability of the table", y="share found", grid="both")
    heights = result.groups["height"]
    places = [float(number) for number in range(len(heights))]
    right.plot(
        places,
        [group.expected for group in heights],
        "s",
        mfc="none",
        mec="black",
        ms=6,
    )
    draw_intervals(right, places, [group.recall for group in heights], **look)
    right.set_xticks(
        places, [group.name.removesuffix(" px") for group in heights], rotation=35
    )
    finish_axes(right, x="height in the image, px (squares: the table)", grid="y")
    for axes in (left, right):
        axes.set_ylim(0.0, 1.02)
    return figure


def draw_intervals(
    axes: "Axes", places: ArrayLike, intervals: Sequence[Interval], **look: Any
) -> Any:
    """Dots with bars from the lower to the upper end of their intervals.

    Matplotlib's handle.
    """
    value = np.array([one.value for one in intervals])
    bars = [
        value - [one.low for one in intervals],
        [one.high for one in intervals] - value,
    ]
    return axes.errorbar(places, value, yerr=np.maximum(bars, 0.0), **look)
