"""Pages of drawn pictures, photographs, and how much drawn people look like people.

``python -m experiments.perception_lab.training.pictures sheet`` puts forty of them on one
page. ``.. photographs FOLDER`` shows photographs to the shipped network. ``.. judge`` shows many to
a detector that was trained on photographs by others, the people detector of OpenCV, which is no
dependency of the program: it comes with ``uv run --no-default-groups --group judge python -m ..``.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.resources import files
from itertools import count, islice, pairwise, product
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from geometry.arrays import BoolArray, FloatArray
from geometry.errors import InputError, Unquoted, refuse
from geometry.image_boxes import box_height_px, iou
from placement.detectors import load_detector, load_min_iou
from placement.detectors.fitting import poisson, wilson
from placement.detectors.network import NetworkDetector
from placement.question import Question
from placement.recordings.files import read_lines
from placement.setting import Setting, build_setting

from ...results.numbers import percent
from ...results.tables import page_of
from .crops import (
    TRAINED,
    WEATHERS,
    Backdrops,
    Crops,
    Framing,
    load_crops,
    load_junction,
    look_around,
)

_CASES = "CPNA-75,CPFA-50,CPLA-25,CPNCO-50,CBNA,CBLA"
_WORDS = ("adult", "child", "cyclist")
_TRAINING = "python -m experiments.perception_lab.training"
_LEAST_SEEN = 0.95  # share: what is hidden more is not judged
_LEAST_SPREAD = 8.0  # of grey, 0 .. 255: at night, who stands in no light is not on the page
_MOST_DARK = 100  # of these one after the other
_TILE_PX, _CAPTION_PX, _COLUMNS, _TILES = 240, 30, 8, 40
_SHEET_HEIGHTS_PX = (40.0, 160.0)
_JUDGED_HEIGHTS_PX = (48.0, 250.0)
_JUDGED_PX = (640, 480)
_EDGES_PX = (48.0, 64.0, 96.0, 128.0, 250.0)
_ASPECT = 0.41  # width of people's boxes by their height
_BODY_SHARE = 0.75  # of the detector's window is the height of the person in it
_SCALE = 2  # pictures are shown enlarged: the window is 128 px high

Judge = Callable[[NDArray[np.uint8]], FloatArray]
"""Boxes (n, 4) of people in a picture (h, w, 3), RGB."""


def _rows(
    settings: Sequence[Setting], framing: Framing, seed: Sequence[int], backdrops: Backdrops
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Junctions in turn, and a picture of somebody who is hardly hidden, without end."""
    looks = [
        look_around(setting, framing, np.random.default_rng([*seed, number]), backdrops=backdrops)
        for number, setting in enumerate(settings)
    ]
    while True:
        for setting, look in zip(settings, looks, strict=True):
            yield (
                setting.scene.name,
                next(
                    row
                    for row in look
                    if row["vru_class"] >= 0
                    and row["visible_share"] >= _LEAST_SEEN
                    and box_height_px(row["box_px"]) >= framing.height_px[0]
                ),
            )


Looks = Sequence[Iterator[tuple[str, dict[str, Any]]]]
"""Junctions and pictures of each class and weather, without end."""


def draw_looks(settings: Sequence[Setting], *, seed: int) -> Looks:
    """Adults, children and cyclists by day, at night and in rain, drawn as they are asked for."""
    backdrops: Backdrops = {}
    return [
        _rows(
            [*settings[number % len(settings) :], *settings[: number % len(settings)]],
            Framing(
                height_px=_SHEET_HEIGHTS_PX,
                crop_px=(_TILE_PX, _TILE_PX),
                empty_share=0.0,
                kinds=(kind,),
                weathers=(weather,),
                varied=1.0,
            ),
            (seed, number),
            backdrops,
        )
        for number, (weather, kind) in enumerate(product(WEATHERS, TRAINED))
    ]


def stored_looks(folder: Path, *, seed: int) -> Looks:
    """Pictures as of :func:`draw_looks`, out of crops stored for training, ``JUNCTION-SEED.npz``.

    Raises InputError: the folder has none, or none of a class in a weather.
    """
    parts = {
        path.stem.rpartition("-")[0]: load_crops(path) for path in sorted(folder.glob("*.npz"))
    }
    return [
        _stored(parts, kind, weather, np.random.default_rng([seed, weather, kind]), folder)
        for weather, kind in product(range(len(WEATHERS)), range(len(TRAINED)))
    ]


def _stored(
    parts: Mapping[str, Crops], kind: int, weather: int, rng: np.random.Generator, folder: Path
) -> Iterator[tuple[str, dict[str, Any]]]:
    """A crop of each junction in turn."""
    rows = {}
    for name, crops in parts.items():
        of_kind = (crops.vru_class == kind) & (crops.weather == weather)
        is_clear = (crops.visible_share >= _LEAST_SEEN) & (
            box_height_px(crops.box_px) >= _SHEET_HEIGHTS_PX[0]
        )
        rows[name] = rng.permutation(np.flatnonzero(of_kind & is_clear))
    names = [name for name in rng.permutation(list(rows)).tolist() if len(rows[name])]
    if not names:
        expected = f"crops of {_WORDS[kind]}s, {WEATHERS[weather]}, made by {_TRAINING}"
        refuse(str(folder), "none", expected)
    for turn in count():
        name = names[turn % len(names)]
        row = int(rows[name][turn // len(names) % len(rows[name])])
        yield name, {field: getattr(parts[name], field)[row] for field in Crops.__slots__}


def draw_sheet(looks: Looks, *, tell: Callable[[str], None] = lambda words: None) -> Image.Image:
    """Forty pictures on a page, one of each class and weather after the other.

    Whom no light reaches is not on it; `tell` gets how many were left out. Raises InputError: light
    reaches none of a hundred.
    """
    tiles, n_dark = [], 0
    for number in range(_TILES):
        drawn = islice(looks[number % len(looks)], _MOST_DARK)
        for name, row in drawn:
            if _stands_out(row):
                tiles.append((name, row))
                break
            n_dark += 1
        else:
            refuse("pictures", "only dark ones", "some that light reaches")
    side = len(tiles[0][1]["rgb"])
    size = (_COLUMNS * side, _TILES // _COLUMNS * (side + _CAPTION_PX))
    sheet = Image.new("RGB", size, "white")
    pen = ImageDraw.Draw(sheet)
    for number, (name, row) in enumerate(tiles):
        left = number % _COLUMNS * side
        top = number // _COLUMNS * (side + _CAPTION_PX)
        sheet.paste(Image.fromarray(row["rgb"]), (left, top))
        height = round(float(box_height_px(row["box_px"])))
        caption = f"{_WORDS[row['vru_class']]}, {WEATHERS[row['weather']]}, {height} px"
        tell(f"{number + 1} of {_TILES}: {caption}, {name}")
        pen.text((left + 3, top + side + 1), f"{caption}\n{name}", fill="black", spacing=2)
    tell(f"{n_dark} left out: no light reaches them")
    return sheet


def _stands_out(row: Mapping[str, Any]) -> bool:
    left, top, right, bottom = np.asarray(row["box_px"], dtype=np.int64)
    return float(row["rgb"][top:bottom, left:right].mean(axis=2).std()) >= _LEAST_SPREAD


def load_people_detector() -> Judge:
    """OpenCV's detector of upright people.

    Raises InputError: there is no OpenCV, or version 5, which has no such detector any more.

    References
    ----------
    .. [1] N. Dalal, B. Triggs, "Histograms of oriented gradients for human detection", 2005: people
       96 px high in windows of 64 x 128 px, from photographs.
    """
    need = "opencv-python-headless below 5: uv run --no-default-groups --group judge .."
    try:
        import cv2
    except ModuleNotFoundError:
        raise InputError("judge", "no OpenCV", need) from None
    library: Any = cv2  # another version may be installed than its types are of
    if not hasattr(library, "HOGDescriptor"):
        raise InputError("judge", f"OpenCV {cv2.__version__}", need)
    hog = library.HOGDescriptor()
    hog.setSVMDetector(library.HOGDescriptor_getDefaultPeopleDetector())

    def find(rgb: NDArray[np.uint8]) -> FloatArray:
        bgr = np.ascontiguousarray(rgb[..., ::-1])
        large = cv2.resize(bgr, None, fx=_SCALE, fy=_SCALE, interpolation=cv2.INTER_LINEAR)
        found, _ = hog.detectMultiScale(large, winStride=(8, 8), padding=(16, 16), scale=1.1)
        corner = np.asarray(found, dtype=np.float64).reshape(-1, 4) / _SCALE
        middle, height = corner[:, :2] + 0.5 * corner[:, 2:], _BODY_SHARE * corner[:, 3]
        return _boxes(middle, height)

    return find


def _boxes(middle_px: FloatArray, height_px: FloatArray) -> FloatArray:
    """Boxes (n, 4) of people around points (n, 2).

    References
    ----------
    .. [1] P. Dollar et al., "Pedestrian detection: an evaluation of the state of the art", 2012:
       labels and detections are given the same aspect, 0.41, for legs and arms move.
    """
    half = 0.5 * np.column_stack([_ASPECT * height_px, height_px])
    return np.concatenate([middle_px - half, middle_px + half], axis=1)


def judge_pictures(
    settings: Sequence[Setting], judge: Judge, *, n_pictures: int, kind: str, seed: int
) -> tuple[FloatArray, NDArray[np.int64], BoolArray, int]:
    """Heights (n,) of people in pictures, weather, who is found, and all false alarms.

    Each picture has one road user of a kind of ``TRAINED`` who is hardly hidden.
    """
    framing = Framing(
        height_px=_JUDGED_HEIGHTS_PX,
        crop_px=_JUDGED_PX,
        empty_share=0.0,
        vut_share=0.4,
        kinds=(kind,),
        varied=1.0,
    )
    rows_of_all = _rows(settings, framing, (seed, TRAINED.index(kind)), {})
    rows, found, n_alarms = [], [], 0
    for _, row in islice(rows_of_all, n_pictures):
        box = row["box_px"][None]
        label = _boxes(0.5 * (box[:, :2] + box[:, 2:]), box_height_px(box))
        boxes = judge(row.pop("rgb"))
        overlap = iou(label, boxes)
        found.append(bool((overlap > 0.5).any()))
        n_alarms += int((overlap <= 0.0).sum())
        rows.append(row)
    height = box_height_px([row["box_px"] for row in rows])
    return height, np.array([row["weather"] for row in rows]), np.array(found), n_alarms


def judge_text(
    settings: Sequence[Setting],
    judge: Judge,
    *,
    n_pictures: Sequence[int],
    seed: int,
    tell: Callable[[str], None],
) -> str:
    """Recall by height and weather, and false alarms, as Markdown; `n_pictures` by class."""
    rows = []
    for kind, word, n in zip(TRAINED, _WORDS, n_pictures, strict=True):
        if not n:
            continue
        tell(f"{n} pictures of kind {kind}")
        height, weather, found, n_alarms = judge_pictures(
            settings, judge, n_pictures=n, kind=kind, seed=seed
        )
        rate = poisson(n_alarms, n)
        alarms = f"{rate.value:.2f} ({rate.low:.2f} to {rate.high:.2f})"
        rows.append(_line(word, found, alarms))
        for low, high in pairwise(_EDGES_PX):
            mask = (height >= low) & (height < high)
            rows.append(_line(f"{word}, {low:g} to {high:g} px", found[mask]))
        rows += [
            _line(f"{word}, {name}", found[weather == number])
            for number, name in enumerate(WEATHERS)
        ]
    return page_of(
        files(__package__) / "pictures_judged.md.j2",
        size_px=_JUDGED_PX,
        least=percent(_LEAST_SEEN),
        names=[setting.scene.name for setting in settings],
        seed=seed,
        rows=rows,
    )


def _line(name: str, found: BoolArray, alarms: str = "") -> tuple[str, ...]:
    share = wilson(int(found.sum()), len(found))
    interval = f"{percent(share.low)} to {percent(share.high)}"
    return name, f"{len(found)}", percent(share.value), interval, alarms


_KITTI_OBJECT = ("type", "truncated", "occluded", "alpha", "left", "top", "right", "bottom") + (
    *("height", "width", "length", "x", "y", "z", "yaw", "score"),
)
_SIDES = ("left", "top", "right", "bottom")
_FINDERS = {"pedestrian": ("person",), "cyclist": ("cyclist", "person"), "motorcyclist": ()}
"""By what is labelled: which boxes of a network find it; on a motorcyclist none is a false one."""


def photographs_text(folder: Path, network: NetworkDetector) -> str:
    """What a network finds in photographs with KITTI's labels, as Markdown.

    FOLDER has ``image_2/NAME.jpg`` or ``.png`` and ``label_2/NAME.txt``. Raises InputError: there
    is none, or a picture or a line of labels is not what it should be.
    """
    labels = sorted((folder / "label_2").glob("*.txt"))
    if not labels:
        refuse(str(folder / "label_2"), "no labels", "files NAME.txt")
    height: dict[str, list[float]] = {name: [] for name in _FINDERS}
    found: dict[str, list[bool]] = {name: [] for name in _FINDERS}
    n_boxes = n_alarms = 0
    for path in labels:
        seen = network.look(_photograph(folder / "image_2", path.stem))
        seen = seen.take(np.flatnonzero(seen.confidence >= network.min_confidence))
        kinds = np.array([seen.kinds.get(one, "") for one in seen.class_ids.tolist()])
        is_on = np.zeros(len(kinds), dtype=bool)
        for fields in read_lines(path, _KITTI_OBJECT, separator=None, least=8):
            name = fields.words["type"].lower()
            if name not in _FINDERS:
                continue
            box = np.array([fields.box(_SIDES)])
            is_over = (iou(box, seen.boxes_px) > load_min_iou()).reshape(-1)
            is_on |= is_over
            height[name].append(float(box_height_px(box)[0]))
            found[name].append(bool((is_over & np.isin(kinds, _FINDERS[name])).any()))
        n_boxes += len(kinds)
        n_alarms += int((~is_on).sum())
    rows = [
        (
            name,
            f"{len(found[name])}",
            f"{min(height[name]):.0f} to {max(height[name]):.0f} px",
            f"{sum(found[name])}",
        )
        for name in ("pedestrian", "cyclist")
        if found[name]
    ]
    return page_of(
        files(__package__) / "photographs.md.j2",
        n_labels=len(labels),
        least=network.min_confidence,
        n_boxes=n_boxes,
        n_alarms=n_alarms,
        rows=rows,
    )


def _photograph(folder: Path, stem: str) -> NDArray[np.uint8]:
    for path in (folder / f"{stem}.jpg", folder / f"{stem}.png"):
        if path.exists():
            try:
                with Image.open(path) as picture:
                    return np.asarray(picture.convert("RGB"))
            except (OSError, ValueError, Image.DecompressionBombError) as error:
                raise InputError(str(path), Unquoted(error), "a picture") from None
    refuse(str(folder / stem), "no picture", f"{stem}.jpg or {stem}.png")


_MAPS = click.option(
    "--map", "maps", multiple=True, help="A map's file, besides town05, which is built in."
)


@click.group()
def main() -> None:
    """Look at drawn pictures, or have them judged."""


@main.command()
@_MAPS
@click.option(
    "--crops",
    type=click.Path(path_type=Path),
    help="Folder of crops of python -m experiments.perception_lab.training, in place of new ones.",
)
@click.option("--seed", default=0, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), required=True)
def sheet(*, maps: tuple[str, ...], crops: Path | None, seed: int, out: Path) -> None:
    """Forty pictures on one page."""
    if crops is not None and maps:
        raise click.UsageError("--crops: got it with --map; expected one of them")
    looks = (
        draw_looks(_settings(maps), seed=seed) if crops is None else stored_looks(crops, seed=seed)
    )
    draw_sheet(looks, tell=_tell).save(out, quality=90)


@main.command(name="judge")
@_MAPS
@click.option("--adults", default=500, show_default=True)
@click.option("--children", default=100, show_default=True)
@click.option("--cyclists", default=100, show_default=True)
@click.option("--seed", default=0, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), required=True)
def judge_command(
    *, maps: tuple[str, ...], adults: int, children: int, cyclists: int, seed: int, out: Path
) -> None:
    """Let OpenCV's people detector find road users in pictures."""
    judge = load_people_detector()
    text = judge_text(
        _settings(maps), judge, n_pictures=(adults, children, cyclists), seed=seed, tell=_tell
    )
    out.write_text(text, encoding="utf-8")


@main.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--detector", default="cnn", show_default=True, help="cnn, or an .onnx file.")
def photographs(*, folder: Path, detector: str) -> None:
    """Show photographs with KITTI's labels to a network: image_2/ and label_2/ in FOLDER."""
    network = load_detector(detector, where="--detector")
    if not isinstance(network, NetworkDetector):
        raise InputError("--detector", detector, "cnn, or an .onnx file")
    click.echo(photographs_text(folder, network), nl=False)


def _tell(words: str) -> None:
    click.echo(words, err=True)


def _settings(maps: Sequence[str]) -> list[Setting]:
    question = Question(cases=_CASES, along_arms="0", speeds="20,50")
    return [build_setting(question, load_junction(name)) for name in ("town05", *maps)]


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        raise SystemExit(f"error: {error}") from None
