"""Exported neural networks (ONNX) as detectors of road users in pictures.

Every family of networks lays its outputs out in its own way, and the file does not say
which it is. So the outputs of one trial run are looked at, and an :class:`Export` says
how all are read.
"""

import ast
import math
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PilImage

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.errors import InputError, MissingExtraError, Unquoted, refuse
from geometry.image_boxes import clip_boxes, iou
from geometry.opening import check_file
from geometry.phrases import Phrase, join_phrases
from geometry.tables import take
from geometry.text_formats import load_data

from .evidence import (
    VRU_CLASSES,
    Crop,
    Detections,
    Evidence,
    Image,
    LidarTable,
    limits_of,
    load_min_iou,
)
from .response import load_table

# ---------- outputs of exported detectors, recognised by their names, shapes and types
Array = NDArray[Any]
Outputs = Mapping[str, Array]
# Boxes (n, 4), classes (n,) and confidence (n,).
Found = tuple[Array, Array, Array]

VRU_KINDS = ("person", "bicycle", "cyclist")
# What a network's classes may mean here.
KINDS = (
    *VRU_KINDS,
    "motorcycle",
    "motorcyclist",
    "car",
)

_EXPECTED = (
    "a detector's outputs: boxes (n, 4), labels (n,), scores (n,); (1, n, 5 + classes);"
    " (1, 4 + classes, n); (1, n, 6); or logits (1, n, classes), pred_boxes (1, n, 4);"
    " with names in the metadata, or COCO's 80 or 91 classes"
)
# DETR, its first implementation, RF-DETR. Other pairs of these shapes are no logits
# (YOLO-NAS).
_QUERY_NAMES = (
    ("logits", "pred_boxes"),
    ("pred_logits", "pred_boxes"),
    ("labels", "dets"),
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Export:
    """How a network's outputs are read, and what it needs to be shown.

    Attributes
    ----------
    kinds : mapping of int to str
        Class to one of ``KINDS``; others are left out.
    read : callable
        Outputs to boxes (n, 4), classes (n,), confidence (n,).
    stride_px : int
        Images of free size are padded to multiples of this. [px]
    is_suppressed : bool
        Overlapping boxes of one class have been removed.
    is_imagenet : bool
        Images are normalised by ImageNet's mean and spread.
    is_relative : bool
        Boxes are shares of the image's width and height, not pixels.
    """

    kinds: Mapping[int, str]
    read: Callable[[Outputs], Found]
    stride_px: int = 1
    is_suppressed: bool = True
    is_imagenet: bool = False
    is_relative: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Numbering:
    """Classes by number, as a file may use them.

    Attributes
    ----------
    n_classes : int
        How many there are.
    kinds : mapping of int to str
        Class to one of ``KINDS``; others are left out.
    is_coco91 : bool
        COCO's 91 classes.
    """

    n_classes: int
    kinds: Mapping[int, str]
    is_coco91: bool = False


@cache
def onnx_setting(key: str) -> Any:
    """Value of a key in ``data/onnx.toml``."""
    return take(load_data(__package__, "onnx.toml"), key, "onnx.toml")


def _labelled(outputs: Outputs, numberings: list[_Numbering]) -> Export | None:
    """How boxes, labels and scores are read; None for other outputs.

    They are known by shape and type: torchvision, and RT-DETR in batches.
    """
    is_batch = all(v.ndim > 1 and len(v) == 1 for v in outputs.values())
    rows = dict(outputs)
    if is_batch:
        rows = {n: v[0] for n, v in outputs.items()}
    boxes = [n for n, v in rows.items() if v.ndim == 2 and v.shape[1] == 4]
    labels = [n for n, v in rows.items() if v.ndim == 1 and v.dtype.kind == "i"]
    scores = [n for n, v in rows.items() if v.ndim == 1 and v.dtype.kind == "f"]
    if not len(boxes) == len(labels) == len(scores) == 1:
        return None

    def read(found: Outputs) -> Found:
        return (
            found[boxes[0]].reshape(-1, 4),
            found[labels[0]].reshape(-1),
            found[scores[0]].reshape(-1),
        )

    # Labels do not tell their number: torchvision uses COCO's 91, RT-DETR, in batches,
    # its 80.
    numbering = numberings[-1]
    if is_batch:
        numbering = numberings[0]
    return Export(kinds=numbering.kinds, read=read)


def _queries(outputs: Outputs, numbering: _Numbering) -> Export | None:
    """How the outputs of DETR and its relatives are read; None for others.

    They are logits (1, n, classes), often with one for "none", and boxes (1, n, 4).
    """
    names = next((pair for pair in _QUERY_NAMES if outputs.keys() == set(pair)), None)
    if names is None:
        return None
    logits, boxes = names
    shape = outputs[logits].shape
    if len(shape) != 3 or shape[0] != 1 or outputs[boxes].shape != (1, shape[1], 4):
        return None
    n_more = shape[2] - numbering.n_classes
    if n_more not in (0, 1):
        return None

    def read(found: Outputs) -> Found:
        # Imported here: SciPy takes longer to load than everything else.
        from scipy.special import (
            expit,
            softmax,
        )

        values = found[logits][0].astype(np.float64)
        if n_more:
            scores = softmax(values, axis=-1)[:, :-1]
        else:
            scores = expit(values)
        return _around(found[boxes][0]), *_best(scores)

    return Export(
        kinds=numbering.kinds,
        read=read,
        is_relative=True,
        is_imagenet=numbering.is_coco91,
    )


def _table(outputs: Outputs, numbering: _Numbering) -> Export | None:
    """How one table (1, rows, columns) is read; None for other outputs.

    YOLO, with or without suppression.
    """
    (value,) = outputs.values()
    if value.ndim != 3 or len(value) != 1:
        return None
    rows, columns = value.shape[1:]
    is_suppressed = columns == 6 and rows <= onnx_setting("max_suppressed")
    has_objectness = columns == 5 + numbering.n_classes
    if not (is_suppressed or has_objectness or rows == 4 + numbering.n_classes):
        return None

    def read(found: Outputs) -> Found:
        ((table,),) = found.values()
        # Each row holds corners, score and class.
        if is_suppressed:
            return table[:, :4], table[:, 5], table[:, 4]
        # Each row holds middle, size, objectness and a score per class.
        if has_objectness:
            return _around(table[:, :4]), *_best(table[:, 5:] * table[:, 4:5])
        # Each column holds middle, size and a score per class.
        return _around(table[:4].T), *_best(table[4:].T)

    return Export(
        kinds=numbering.kinds,
        read=read,
        stride_px=onnx_setting("stride_px"),
        is_suppressed=is_suppressed,
    )


def _around(centred: Array) -> Array:
    """Boxes (n, 4) from middle, width and height."""
    half = 0.5 * centred[:, 2:]
    return np.concatenate([centred[:, :2] - half, centred[:, :2] + half], axis=1)


def _best(scores: Array) -> tuple[Array, Array]:
    """Best class (n,) and its score (n,), of scores (n, classes)."""
    return scores.argmax(axis=1), scores.max(axis=1)


def _numberings(names: str | None, where: str) -> list[_Numbering]:
    """Numberings that a file may use: its own, or COCO's."""
    if names is None:
        named = None
    else:
        named = _read_names(names, where)
    if named is not None:
        return [named]
    return [
        _Numbering(
            n_classes=entry["n_classes"],
            kinds={entry[kind]: kind for kind in KINDS if kind in entry},
            is_coco91=key == "coco91",
        )
        for key, entry in onnx_setting("classes").items()
    ]


def _read_names(text: str, where: str) -> _Numbering | None:
    """Numbering from class names as Ultralytics writes them.

    Parameters
    ----------
    text : str
        A dictionary, or a list, as Python shows it.
    where : str
        Names the file in messages.

    Returns
    -------
    numbering : _Numbering or None
        None where every class is named by its own number, as in files trained without
        names.

    Raises
    ------
    InputError
        The text is neither a dictionary nor a list.
    """
    try:
        value = ast.literal_eval(text)
    except (ValueError, SyntaxError):
        value = None
    if isinstance(value, list):
        value = dict(enumerate(value))
    if not isinstance(value, dict) or not all(isinstance(key, int) for key in value):
        raise InputError(where, text, "a dictionary from number to name")
    words = {key: str(name).strip().lower() for key, name in value.items()}
    if all(word == str(key) for key, word in words.items()):
        return None
    known = kind_of_name()
    kinds = {key: known[word] for key, word in words.items() if word in known}
    return _Numbering(n_classes=len(words), kinds=kinds)


def kind_of_name() -> dict[str, str]:
    """One of ``KINDS`` by class name."""
    return {
        word: kind for kind, words in onnx_setting("names").items() for word in words
    }


# ---------- images in, boxes out
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Letterbox:
    """An image scaled without distortion, with grey padding.

    Attributes
    ----------
    pixels : (h, w, 3) uint8
        RGB.
    scale : (2,) float
        Pixels per pixel of the given image, across and down.
    offset_px : (2,) float
        Padding on the left and on top. [px]
    """

    pixels: NDArray[np.uint8]
    scale: FloatArray
    offset_px: FloatArray

    def to_image(self, boxes_px: FloatArray) -> FloatArray:
        """Boxes of the given image, from boxes (n, 4) of the letterbox."""
        corners = (boxes_px.reshape(-1, 2, 2) - self.offset_px) / self.scale
        return corners.reshape(-1, 4)


def letterbox(
    image: NDArray[np.uint8], *, width_px: int, height_px: int, scale: float
) -> Letterbox:
    """Scale an image and put it into the middle of a grey one.

    Parameters
    ----------
    image : (h, w, 3) uint8
        RGB.
    width_px, height_px : int
        Size of the grey image. [px]
    scale : float
        Must let the image fit.
    """
    height, width = image.shape[:2]
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    if size != (width, height):
        image = np.asarray(
            PilImage.fromarray(image).resize(size, PilImage.Resampling.BILINEAR)
        )
    left = (width_px - size[0]) // 2
    top = (height_px - size[1]) // 2
    pixels = np.full((height_px, width_px, 3), onnx_setting("fill"), dtype=np.uint8)
    pixels[top : top + size[1], left : left + size[0]] = image
    return Letterbox(
        pixels=pixels,
        scale=np.array([size[0] / width, size[1] / height]),
        offset_px=np.array([left, top], dtype=np.float64),
    )


_IMAGE = "one image input, (1, 3, height, width) or (3, height, width), RGB"
_PIXEL_TYPES: dict[str, type[np.generic]] = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(uint8)": np.uint8,
}
# Further inputs of DETR and RT-DETR, whose values are known.
_SIDE_INPUTS = (
    "pixel_mask",
    "orig_target_sizes",
)


@dataclass(frozen=True, slots=True, eq=False)
class ImageBoxes:
    """Boxes that a network finds in an image, by descending confidence.

    Attributes
    ----------
    boxes_px : (n, 4) float
        Inside the image. [px]
    class_ids : (n,) int
        As the network numbers its classes.
    confidence : (n,) float
        0 to 1.
    kinds : mapping of int to str
        Class to one of ``KINDS``; others are left out.
    """

    boxes_px: FloatArray
    class_ids: IntArray
    confidence: FloatArray
    kinds: Mapping[int, str]

    def take(self, rows: IntArray) -> "ImageBoxes":
        """Boxes of some rows, in the given order."""
        return ImageBoxes(
            self.boxes_px[rows], self.class_ids[rows], self.confidence[rows], self.kinds
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Session:
    """A network in the ONNX runtime, whatever it computes.

    Attributes
    ----------
    path : Path
        The file.
    session : onnxruntime.InferenceSession
        The loaded network.
    image_input : str
        Name of the input for the image.
    side_inputs : tuple of str
        Names of further inputs, which are known without asking.
    has_batch : bool
        The image has an axis of its own for the batch.
    height_px, width_px : int or None
        Size of the image; None: free. [px]
    pixel_type : type
        Of the image's numbers.
    class_names : str or None
        From the file's metadata.
    """

    path: Path
    session: Any
    image_input: str
    side_inputs: tuple[str, ...]
    has_batch: bool
    height_px: int | None
    width_px: int | None
    pixel_type: type[np.generic]
    class_names: str | None

    def run(self, pixels: NDArray[np.uint8], *, is_imagenet: bool) -> dict[str, Array]:
        """Outputs for an image, by name.

        Parameters
        ----------
        pixels : (h, w, 3) uint8
            RGB.
        is_imagenet : bool
            Normalise by ImageNet's mean and spread.

        Raises
        ------
        InputError
            The network fails.
        """
        image = pixels.astype(self.pixel_type)
        if self.pixel_type is not np.uint8:
            image = pixels.astype(np.float32) / np.float32(255.0)
            if is_imagenet:
                image = (image - onnx_setting("imagenet_mean")) / onnx_setting(
                    "imagenet_std"
                )
            image = image.astype(self.pixel_type)
        chw = np.ascontiguousarray(image.transpose(2, 0, 1))
        height, width = pixels.shape[:2]
        sides = {
            "pixel_mask": np.ones((1, height, width), dtype=np.int64),
            "orig_target_sizes": np.array([[width, height]], dtype=np.int64),
        }
        feed = {self.image_input: chw}
        if self.has_batch:
            feed = {self.image_input: chw[None]}
        feed |= {name: sides[name] for name in self.side_inputs}
        names = [output.name for output in self.session.get_outputs()]
        try:
            values = self.session.run(names, feed)
        except Exception as error:
            # Onnxruntime's own errors share no other base.
            raise InputError(
                str(self.path), _first_line(error), "a network that runs"
            ) from None
        return {
            name: np.asarray(value) for name, value in zip(names, values, strict=True)
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OnnxModel:
    """A detector from an ONNX file; several threads may use it at once.

    Attributes
    ----------
    path : Path
        The file.
    session : _Session
        The network.
    export : Export
        How its outputs are read.
    """

    path: Path
    session: _Session
    export: Export

    def detect(self, image: NDArray[np.uint8]) -> ImageBoxes:
        """Find what the network knows in an image.

        Parameters
        ----------
        image : (h, w, 3) uint8
            RGB.

        Returns
        -------
        boxes : ImageBoxes
            In pixels of the image.

        Raises
        ------
        InputError
            The image has another shape or type, the network fails, or a box is not
            finite.
        """
        if (
            image.dtype != np.uint8
            or image.ndim != 3
            or image.shape[2] != 3
            or image.size == 0
        ):
            got = f"{image.dtype} of shape {image.shape}"
            refuse("image", got, "uint8 of shape (height, width, 3)")
        fitted = _fit(image, self.session, self.export.stride_px)
        outputs = self.session.run(fitted.pixels, is_imagenet=self.export.is_imagenet)
        boxes, class_ids, confidence = self.export.read(outputs)
        # NaN stays, and is reported below.
        is_sure = ~(confidence < onnx_setting("min_confidence"))
        boxes = boxes[is_sure].astype(np.float64)
        class_ids = class_ids[is_sure].astype(np.int64)
        confidence = confidence[is_sure].astype(np.float64)
        if not (np.isfinite(boxes).all() and np.isfinite(confidence).all()):
            refuse(str(self.path), "a box that is not a number", "finite boxes")
        if self.export.is_relative:
            height, width = fitted.pixels.shape[:2]
            boxes = boxes * [width, height, width, height]
        height, width = image.shape[:2]
        boxes = clip_boxes(fitted.to_image(boxes), width_px=width, height_px=height)
        order = np.argsort(-confidence, kind="stable")
        # Boxes in the padding are empty once they are clipped.
        order = order[(boxes[order, :2] < boxes[order, 2:]).all(axis=1)]
        if not self.export.is_suppressed:
            left = suppress(
                boxes[order], class_ids[order], max_iou=onnx_setting("max_iou")
            )
            order = order[left]
        found = ImageBoxes(boxes, class_ids, confidence, self.export.kinds)
        return found.take(order)


def load_onnx_model(path: Path) -> OnnxModel:
    """Load a detector from an ONNX file.

    As exported from torchvision, YOLO (v5, v8 and later, end to end) or DETR. A
    grey image is shown to the network once, to see what it gives.

    Raises
    ------
    InputError
        The file is no detector, or no class of it is known.
    MissingExtraError
        onnxruntime is not installed.

    Notes
    -----
    YOLOX cannot be distinguished from YOLOv5, but expects blue first and 0 .. 255,
    and gives steps of its grid instead of pixels: its boxes come out wrong. Without
    class names in the file's metadata, COCO's 80 or 91 classes are decided by their
    number, 91 where the file gives labels only.
    """
    if not path.is_file():
        refuse(str(path), "no such file", "an ONNX file")
    session = _open(path)
    side = onnx_setting("probe_px")
    shape = (session.height_px or side, session.width_px or side, 3)
    grey = np.full(shape, onnx_setting("fill"), dtype=np.uint8)
    outputs = session.run(grey, is_imagenet=False)
    where = f"{path}: metadata 'names'"
    numberings = _numberings(session.class_names, where)
    if len(outputs) >= 3:
        export = _labelled(outputs, numberings)
    else:
        if len(outputs) == 2:
            family = _queries
        else:
            family = _table
        exports = (family(outputs, numbering) for numbering in numberings)
        export = next((export for export in exports if export is not None), None)
    if export is None:
        shapes = ", ".join(f"{name} {value.shape}" for name, value in outputs.items())
        refuse(str(path), f"outputs {shapes}", _EXPECTED)
    if not export.kinds:
        expected = "among them one of " + ", ".join(sorted(kind_of_name()))
        raise InputError(where, session.class_names, expected)
    return OnnxModel(path=path, session=session, export=export)


def boxes_of_class(found: ImageBoxes, vru_class: str) -> tuple[FloatArray, FloatArray]:
    """Boxes that count for a class of road user, and their confidence.

    Parameters
    ----------
    found : ImageBoxes
        What a network finds in an image.
    vru_class : str
        One of ``VRU_CLASSES``.

    Returns
    -------
    boxes_px : (n, 4) float
        [px]
    confidence : (n,) float
        0 to 1.

    Notes
    -----
    A network that knows persons and bicycles finds a cyclist as either or both: the
    box around a person and a bicycle that overlap counts as a cyclist, with the
    lower of the two confidences; so does each of them alone, for the other may be
    missed. The same holds for motorcycles. A detection is matched with one road
    user, so surplus boxes do no harm.
    """

    def of_kind(kind: str) -> tuple[FloatArray, FloatArray]:
        ids = [class_id for class_id, name in found.kinds.items() if name == kind]
        mine = np.isin(found.class_ids, ids)
        return found.boxes_px[mine], found.confidence[mine]

    ridden = onnx_setting("ridden")
    if vru_class not in ridden:
        return of_kind(onnx_setting("kinds_of_class")[vru_class][0])
    cycle, rider = ridden[vru_class]
    persons = of_kind("person")
    cycles = of_kind(cycle)
    who, what = np.nonzero(iou(persons[0][:, None], cycles[0][None]) > 0.0)
    # The box around a person and a cycle that overlap.
    person_px = persons[0][who]
    cycle_px = cycles[0][what]
    low = np.minimum(person_px, cycle_px)[:, :2]
    high = np.maximum(person_px, cycle_px)[:, 2:]
    how_sure = np.minimum(persons[1][who], cycles[1][what])
    joined = (np.concatenate([low, high], axis=1), how_sure)
    boxes, confidence = zip(joined, of_kind(rider), persons, cycles, strict=True)
    return np.concatenate(boxes), np.concatenate(confidence)


def suppress(boxes_px: FloatArray, class_ids: IntArray, *, max_iou: float) -> IntArray:
    """Indices of boxes that survive greedy non-maximum suppression.

    Parameters
    ----------
    boxes_px : (n, 4) float
        In descending order of confidence. [px]
    class_ids : (n,) int
        Boxes of different classes do not suppress one another.
    max_iou : float
        A box goes if a better one of its class overlaps it by more.

    Returns
    -------
    left : (m,) int
        Ascending.
    """
    is_left: BoolArray = np.ones(len(boxes_px), dtype=bool)
    for index in range(len(boxes_px)):
        if is_left[index]:
            later = index + 1 + np.flatnonzero(is_left[index + 1 :])
            later = later[class_ids[later] == class_ids[index]]
            is_left[later[iou(boxes_px[later], boxes_px[index]) > max_iou]] = False
    return np.flatnonzero(is_left)


def _fit(image: NDArray[np.uint8], session: _Session, stride_px: int) -> Letterbox:
    """Image as the network needs it.

    Scaled to fixed sides, padded to the grid along free ones.
    """
    height, width = image.shape[:2]
    sides = ((session.width_px, width), (session.height_px, height))
    scale = min(
        (fixed / side for fixed, side in sides if fixed is not None), default=1.0
    )
    fitted = []
    for fixed, side in sides:
        if fixed is None:
            fitted.append(math.ceil(side * scale / stride_px) * stride_px)
        else:
            fitted.append(fixed)
    across, down = fitted
    return letterbox(image, width_px=across, height_px=down, scale=scale)


def _open(path: Path) -> _Session:
    """Open an ONNX file and find its image input.

    Raises
    ------
    InputError
        The file is not ONNX, or has no image input.
    MissingExtraError
        onnxruntime is not installed.
    """
    try:
        import onnxruntime
    except ModuleNotFoundError:
        raise MissingExtraError(
            "an .onnx detector needs onnxruntime: pip install place-rsus[perception] "
            "(in a checkout: uv run --extra perception place-rsus ..)"
        ) from None
    check_file(path)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    # Errors are reported once, by us.
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(
            str(path), options, providers=["CPUExecutionProvider"]
        )
    except Exception as error:
        # Onnxruntime's own errors share no other base.
        raise InputError(str(path), _first_line(error), "an ONNX file") from None
    inputs = session.get_inputs()
    images = [entry for entry in inputs if entry.name not in _SIDE_INPUTS]
    shape = []
    if len(images) == 1:
        shape = list(images[0].shape)
    has_batch = len(shape) == 4
    is_image = len(shape) in (3, 4) and _may_be(shape[-3], 3)
    is_image = is_image and (not has_batch or _may_be(shape[0], 1))
    if not is_image or images[0].type not in _PIXEL_TYPES:
        got = ", ".join(
            f"{entry.name} {entry.type} {tuple(entry.shape)}" for entry in inputs
        )
        refuse(str(path), f"inputs {got or 'none'}", _IMAGE)
    height, width = (_fixed_px(side) for side in shape[-2:])
    return _Session(
        path=path,
        session=session,
        image_input=images[0].name,
        side_inputs=tuple(entry.name for entry in inputs if entry.name in _SIDE_INPUTS),
        has_batch=has_batch,
        height_px=height,
        width_px=width,
        pixel_type=_PIXEL_TYPES[images[0].type],
        class_names=session.get_modelmeta().custom_metadata_map.get("names"),
    )


def _fixed_px(side: object) -> int | None:
    """Declared side of an image; None if it is free."""
    if isinstance(side, int) and side > 0:
        return side
    return None


def _may_be(side: object, expected: int) -> bool:
    """True if a declared size is the expected one, or free."""
    return not isinstance(side, int) or side in (expected, -1)


def _first_line(error: Exception) -> Unquoted:
    """First line of a library's message."""
    return Unquoted(str(error).strip().split("\n")[0] or type(error).__name__)


# ---------- the detector
_SCALES = (1, 2, 4, 8)
_NO_WORDS = Phrase("")
_CHOSEN_BY = {
    "geometric": Phrase("Poses are chosen by boxes alone."),
    "cnn-table": Phrase("Poses are chosen by the response table fitted to it."),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NetworkDetector:
    """Detects by a network that looks at rendered pictures.

    Pictures in which the VRU is too small are not shown to it. A network that looks at
    crops is shown the surroundings of the VRU only; whole pictures it sees at several
    scales.

    Attributes
    ----------
    name : str
        Name of the file, or "cnn".
    model : OnnxModel
        The network.
    min_box_height_px : float
        Least height of the visible box. [px]
    min_confidence : float
        Boxes below it do not count.
    looks_at_crops : bool
        It looks at crops.
    plans_with : str
        Built-in detector by which poses are chosen.
    alarm_words : str
        Sentence on how often it confirms what is not there, if that was measured.
    lidar : LidarTable, optional
        What LiDARs find.
    """

    name: str
    model: OnnxModel
    min_box_height_px: float
    min_confidence: float
    looks_at_crops: bool = False
    # The built-in detector by which poses are chosen.
    plans_with: str = "geometric"
    # how often it confirms what is not there, if that was measured
    alarm_words: Phrase = _NO_WORDS
    lidar: LidarTable | None = None

    needs_pictures = True

    @property
    def seconds_per_picture(self) -> float:
        """Processor seconds to draw a picture and look at it, as measured."""
        if self.looks_at_crops:
            return 0.06
        return 1.0

    @property
    def figures_words(self) -> Phrase:
        """Empty: it has no table of figures."""
        return _NO_WORDS

    def assumed_words(self, classes: Collection[str]) -> Phrase:
        """Empty: it has no table of figures."""
        return _NO_WORDS

    @property
    def description(self) -> Phrase:
        """When it detects."""
        values = {
            "name": self.name,
            "least": self.min_confidence,
            "iou": load_min_iou(),
        }
        looks = Phrase(
            "The network {name} processes rendered pictures. A box counts if its "
            "confidence is at least {least:g} and it overlaps the road user's "
            "visible part by more than {iou:g} (intersection over union).",
            **values,
        )
        if self.looks_at_crops:
            looks = Phrase(
                "The network {name} processes rendered pictures of the area around "
                "the road user. A box counts if its confidence is at least {least:g} "
                "and it overlaps the road user's visible part by more than {iou:g} "
                "(intersection over union).",
                **values,
            )
        words = [looks, _CHOSEN_BY[self.plans_with]]
        if self.alarm_words:
            words.append(self.alarm_words)
        if self.lidar is not None:
            words.append(self.lidar.description)
        return join_phrases(words, " ")

    def look(self, image: Image) -> ImageBoxes:
        """Find road users in a whole picture, (h, w, 3) uint8.

        A network for crops is shown it at full size, a half, a quarter and an
        eighth, for it knows road users of few sizes only.
        """
        if not self.looks_at_crops:
            return self.model.detect(image)
        parts = []
        for scale in _SCALES:
            size = (image.shape[1] // scale, image.shape[0] // scale)
            small = PilImage.fromarray(image).resize(size, PilImage.Resampling.BOX)
            found = self.model.detect(np.asarray(small))
            ratio = np.array([image.shape[1] / size[0], image.shape[0] / size[1]] * 2)
            parts.append((found, found.boxes_px * ratio))
        boxes = np.concatenate([scaled for _, scaled in parts])
        class_ids = np.concatenate([found.class_ids for found, _ in parts])
        confidence = np.concatenate([found.confidence for found, _ in parts])
        order = np.argsort(-confidence, kind="stable")
        left = order[
            suppress(boxes[order], class_ids[order], max_iou=onnx_setting("max_iou"))
        ]
        return ImageBoxes(boxes, class_ids, confidence, parts[0][0].kinds).take(left)

    def look_at(self, crop: Crop) -> ImageBoxes:
        """Find road users in a crop; boxes are in pixels of the whole picture."""
        found = self.model.detect(crop.pixels)
        return replace(found, boxes_px=crop.to_image(found.boxes_px))

    @property
    def known_classes(self) -> frozenset[str]:
        """Classes that it has learnt, of ``VRU_CLASSES``: riders also as persons."""
        kinds = set(self.model.export.kinds.values())
        kinds_of: dict[str, list[str]] = onnx_setting("kinds_of_class")
        return frozenset(
            name for name, words in kinds_of.items() if not kinds.isdisjoint(words)
        )

    def check_classes(self, classes: Iterable[str]) -> None:
        """Raise InputError where the network has not learnt a class.

        Parameters
        ----------
        classes : iterable of str
            Among ``VRU_CLASSES``.
        """
        for name in classes:
            if name not in self.known_classes:
                kinds = onnx_setting("kinds_of_class")[name]
                expected = f"a network that knows {' or '.join(kinds)}"
                refuse(f"detector {self.name}", f"runs with a {name}", expected)

    def detect(self, evidence: Evidence, rng: np.random.Generator) -> Detections:
        """Show each picture in which the VRU is large enough to the network.

        Parameters
        ----------
        evidence : Evidence
            With pictures, or with crops if the network looks at these.
        rng : Generator
            Not used.

        Raises
        ------
        InputError
            The evidence has no pictures.
        """
        pictures: object = evidence.picture
        if self.looks_at_crops:
            pictures = evidence.crops
        if pictures is None:
            refuse("evidence", "no pictures", "pictures for the network")
        height = evidence.visible_px[:, 3] - evidence.visible_px[:, 1]
        large = np.flatnonzero(height >= max(self.min_box_height_px, 1.0e-9)).tolist()
        rows: list[int] = []
        boxes: list[np.ndarray] = []
        confidence: list[np.ndarray] = []
        kinds = np.broadcast_to(evidence.vru_class, len(evidence))
        for row, found in self._find(large, evidence):
            of_class, how_sure = boxes_of_class(found, VRU_CLASSES[kinds[row]])
            is_sure = how_sure >= self.min_confidence
            boxes.append(of_class[is_sure])
            confidence.append(how_sure[is_sure])
            rows += [row] * int(is_sure.sum())
        return Detections(
            row_index=np.array(rows, dtype=np.int64),
            boxes_px=np.concatenate([np.empty((0, 4)), *boxes]),
            confidence=np.concatenate([np.empty(0), *confidence]),
        )

    def _find(
        self, rows: list[int], evidence: Evidence
    ) -> Iterator[tuple[int, ImageBoxes]]:
        """Boxes in the images of rows, or around their VRUs.

        Crops that look the same are looked at once.

        Yields
        ------
        row : int
            Of the evidence.
        found : ImageBoxes
            In pixels of the image.
        """
        if not self.looks_at_crops:
            assert evidence.picture is not None
            for row in rows:
                yield row, self.model.detect(evidence.picture(row))
            return
        assert evidence.crops is not None
        alike: dict[Hashable, list[int]] = {}
        for row in rows:
            alike.setdefault(evidence.crops.key(row), []).append(row)
        same = {group[0]: group for group in alike.values()}
        for first, crop in evidence.crops.draw_all(list(same)):
            found = self.look_at(crop)
            for row in same[first]:
                yield row, found


# ---------- by name or file
_NETWORK_FILE = "vru.onnx"


@cache
def load_shipped_network(name: str) -> NetworkDetector:
    """Network that is shipped, for crops. MissingExtraError: without onnxruntime."""
    table = load_table("cnn-table")
    with as_file(files(__package__) / "data" / _NETWORK_FILE) as path:
        return NetworkDetector(
            name=name,
            model=load_onnx_model(path),
            looks_at_crops=True,
            plans_with=table.name,
            alarm_words=table.alarm_words,
            **limits_of("cnn"),
        )


def load_network_file(path: Path) -> NetworkDetector:
    """Network of a user's file.

    Raises InputError if the file is no detector, MissingExtraError without onnxruntime.
    """
    model = load_onnx_model(path)
    return NetworkDetector(name=path.name, model=model, **limits_of("onnx"))
