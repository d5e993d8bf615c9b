"""The outputs of exported detectors, recognised by their names, shapes and types.

Every family of networks lays its outputs out in its own way, and the file does not say which it
is. So the outputs of one trial run are looked at, and an :class:`Export` says how all are read.
"""

import ast
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.errors import InputError, Unquoted
from geometry.files import load_toml, pick, take

Array = NDArray[Any]
Outputs = Mapping[str, Array]
Found = tuple[Array, Array, Array]  # boxes (n, 4), classes (n,), confidence (n,)

_EXPECTED = (
    "a detector's outputs: boxes (n, 4), labels (n,), scores (n,); (1, n, 5 + classes); "
    "(1, 4 + classes, n); (1, n, 6); or logits (1, n, classes), pred_boxes (1, n, 4); with "
    "names in the metadata, or COCO's 80 or 91 classes"
)
# DETR, its first implementation, RF-DETR. Other pairs of these shapes are no logits (YOLO-NAS).
_QUERY_NAMES = (("logits", "pred_boxes"), ("pred_logits", "pred_boxes"), ("labels", "dets"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Export:
    """How a network's outputs are read, and what it needs to be shown."""

    kinds: Mapping[int, str]  # class to "person", "bicycle" or "cyclist"; others are left out
    # outputs by name to boxes (n, 4), classes (n,), confidence (n,)
    read: Callable[[Outputs], Found]
    stride_px: int = 1  # images of free size are padded to its multiples
    is_suppressed: bool = True  # overlapping boxes of one class have been removed
    is_imagenet: bool = False  # images are normalised by ImageNet's mean and spread
    is_relative: bool = False  # boxes are shares of the image's width and height, not pixels


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Numbering:
    """Classes by number, as a file may use them."""

    n_classes: int
    kinds: Mapping[int, str]
    is_coco91: bool = False


def recognise_export(
    outputs: Outputs, *, path: Path, names: str | None, classes: str | None
) -> Export:
    """How the outputs of a trial run, and of all further ones, are to be read.

    `names` are the class names in the file's metadata; without them, `classes` is "coco80" or
    "coco91", by default what fits. Raises InputError if this is no detector or no class is known.
    """
    where = f"{path}: metadata 'names'"
    export = _recognise(outputs, _numberings(names, classes, where))
    if export is None:
        shapes = ", ".join(f"{name} {value.shape}" for name, value in outputs.items())
        raise InputError(str(path), Unquoted(f"outputs {shapes}"), _EXPECTED)
    if not export.kinds:
        expected = "among them one of " + ", ".join(sorted(kind_of_name()))
        raise InputError(where, names, expected)
    return export


def onnx_setting(key: str) -> Any:
    """Value in ``data/onnx.toml``."""
    return take(_settings(), key, "onnx.toml")


@cache
def _settings() -> dict[str, Any]:
    return load_toml(files(__package__) / "data" / "onnx.toml")


def _recognise(outputs: Outputs, numberings: list[_Numbering]) -> Export | None:
    if len(outputs) >= 3:
        return _labelled(outputs, numberings)
    family = _queries if len(outputs) == 2 else _table
    exports = (family(outputs, numbering) for numbering in numberings)
    return next((export for export in exports if export is not None), None)


def _labelled(outputs: Outputs, numberings: list[_Numbering]) -> Export | None:
    """Boxes, labels and scores, known by shape and type: torchvision; RT-DETR in batches."""
    is_batch = all(v.ndim > 1 and len(v) == 1 for v in outputs.values())
    rows = {n: v[0] if is_batch else v for n, v in outputs.items()}
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

    # Labels do not tell their number: torchvision uses COCO's 91, RT-DETR, in batches, its 80.
    return Export(kinds=numberings[0 if is_batch else -1].kinds, read=read)


def _queries(outputs: Outputs, numbering: _Numbering) -> Export | None:
    """DETR and relatives: logits (1, n, classes), often with one for "none", boxes (1, n, 4)."""
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
        from scipy.special import expit, softmax  # takes longer to load than all else here

        values = found[logits][0].astype(np.float64)
        scores = softmax(values, axis=-1)[:, :-1] if n_more else expit(values)
        return _around(found[boxes][0]), *_best(scores)

    return Export(
        kinds=numbering.kinds, read=read, is_relative=True, is_imagenet=numbering.is_coco91
    )


def _table(outputs: Outputs, numbering: _Numbering) -> Export | None:
    """One table (1, rows, columns): YOLO, with or without suppression."""
    (value,) = outputs.values()
    if value.ndim != 3 or len(value) != 1:
        return None
    rows, columns = value.shape[1:]
    is_suppressed = columns == 6 and rows <= onnx_setting("max_suppressed")
    if is_suppressed:
        read = _read_suppressed
    elif columns == 5 + numbering.n_classes:
        read = _read_with_objectness
    elif rows == 4 + numbering.n_classes:
        read = _read_columns
    else:
        return None
    return Export(
        kinds=numbering.kinds,
        read=read,
        stride_px=onnx_setting("stride_px"),
        is_suppressed=is_suppressed,
    )


def _read_suppressed(outputs: Outputs) -> Found:
    """Corners, score, class in each row."""
    ((table,),) = outputs.values()
    return table[:, :4], table[:, 5], table[:, 4]


def _read_with_objectness(outputs: Outputs) -> Found:
    """Middle, size, objectness and a score per class in each row."""
    ((table,),) = outputs.values()
    return _around(table[:, :4]), *_best(table[:, 5:] * table[:, 4:5])


def _read_columns(outputs: Outputs) -> Found:
    """Middle, size and a score per class in each column."""
    ((table,),) = outputs.values()
    return _around(table[:4].T), *_best(table[4:].T)


def _around(centred: Array) -> Array:
    """Boxes (n, 4) from middle, width and height."""
    half = 0.5 * centred[:, 2:]
    return np.concatenate([centred[:, :2] - half, centred[:, :2] + half], axis=1)


def _best(scores: Array) -> tuple[Array, Array]:
    """Best class (n,) and its score (n,), of scores (n, classes)."""
    return scores.argmax(axis=1), scores.max(axis=1)


def _numberings(names: str | None, classes: str | None, where: str) -> list[_Numbering]:
    """Possible numberings: the file's own, or COCO's."""
    coco = {
        key: _Numbering(
            n_classes=entry["n_classes"],
            kinds={entry[kind]: kind for kind in ("person", "bicycle")},
            is_coco91=key == "coco91",
        )
        for key, entry in onnx_setting("classes").items()
    }
    fitting = list(coco.values()) if classes is None else [pick(coco, classes, "classes")]
    named = None if names is None else _read_names(names, where)
    return fitting if named is None else [named]


def _read_names(text: str, where: str) -> _Numbering | None:
    """Class names as Ultralytics writes them: a dictionary, or a list, as Python shows it.

    Nothing where every class is named by its own number, as in files trained without names.
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
    """The meaning of class names."""
    return {word: kind for kind, words in onnx_setting("names").items() for word in words}
