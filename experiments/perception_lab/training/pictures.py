"""Drawn pictures on a page, and photographs before the shipped network.

``python -m experiments.perception_lab.training.pictures sheet`` puts forty pictures on
one page. ``.. photographs FOLDER`` shows photographs to the shipped network.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.resources import files
from itertools import count, islice, product
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from geometry.errors import InputError, Unquoted, refuse
from geometry.image_boxes import box_height_px, iou
from placement.detectors import load_detector, load_min_iou
from placement.detectors.network import NetworkDetector
from placement.question import Question
from placement.recordings.files import read_lines
from placement.setting import Setting, build_setting

from ...results.tables import page_of
from .crops import (
    TRAINED,
    WEATHERS,
    Backdrops,
    Framing,
    LabelledCrops,
    load_crops,
    load_junction,
    look_around,
)

_CASES = "CPNA-75,CPFA-50,CPLA-25,CPNCO-50,CBNA,CBLA"
_WORDS = ("adult", "child", "cyclist")
_TRAINING = "python -m experiments.perception_lab.training"
_LEAST_SEEN = 0.95  # share: what is hidden more is not on the page
# of grey, 0 .. 255: at night, who stands in no light is not on the page
_LEAST_SPREAD = 8.0
_MOST_DARK = 100  # of these one after the other
_TILE_PX = 240
_CAPTION_PX = 30
_COLUMNS = 8
_TILES = 40
_SHEET_HEIGHTS_PX = (40.0, 160.0)


def _rows(
    settings: Sequence[Setting],
    framing: Framing,
    seed: Sequence[int],
    backdrops: Backdrops,
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Junctions in turn, and a picture of somebody who is hardly hidden, without end."""
    looks = [
        look_around(
            setting,
            framing,
            np.random.default_rng([*seed, number]),
            backdrops=backdrops,
        )
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
        path.stem.rpartition("-")[0]: load_crops(path)
        for path in sorted(folder.glob("*.npz"))
    }
    return [
        _stored(
            parts, kind, weather, np.random.default_rng([seed, weather, kind]), folder
        )
        for weather, kind in product(range(len(WEATHERS)), range(len(TRAINED)))
    ]


def _stored(
    parts: Mapping[str, LabelledCrops],
    kind: int,
    weather: int,
    rng: np.random.Generator,
    folder: Path,
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
        yield (
            name,
            {
                field: getattr(parts[name], field)[row]
                for field in LabelledCrops.__slots__
            },
        )


def draw_sheet(
    looks: Looks, *, tell: Callable[[str], None] = lambda words: None
) -> Image.Image:
    """Forty pictures on a page, one of each class and weather after the other.

    Whom no light reaches is not on it; `tell` gets how many were left out. Raises
    InputError: light reaches none of a hundred.
    """
    tiles = []
    n_dark = 0
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
        pen.text(
            (left + 3, top + side + 1), f"{caption}\n{name}", fill="black", spacing=2
        )
    tell(f"{n_dark} left out: no light reaches them")
    return sheet


def _stands_out(row: Mapping[str, Any]) -> bool:
    left, top, right, bottom = np.asarray(row["box_px"], dtype=np.int64)
    return float(row["rgb"][top:bottom, left:right].mean(axis=2).std()) >= _LEAST_SPREAD


_KITTI_OBJECT = (
    "type",
    "truncated",
    "occluded",
    "alpha",
    "left",
    "top",
    "right",
    "bottom",
) + (*("height", "width", "length", "x", "y", "z", "yaw", "score"),)
_SIDES = ("left", "top", "right", "bottom")
_FINDERS = {
    "pedestrian": ("person",),
    "cyclist": ("cyclist", "person"),
    "motorcyclist": (),
}
"""By what is labelled: which boxes of a network find it; on a motorcyclist none is a false one."""


def photographs_text(folder: Path, network: NetworkDetector) -> str:
    """What a network finds in photographs with KITTI's labels, as Markdown.

    FOLDER has ``image_2/NAME.jpg`` or ``.png`` and ``label_2/NAME.txt``. Raises
    InputError: there is none, or a picture or a line of labels is not what it should
    be.
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
    "--map",
    "maps",
    multiple=True,
    help="A map's file, besides town05, which is built in.",
)


@click.group()
def main() -> None:
    """Look at drawn pictures, or show photographs to a network."""


@main.command()
@_MAPS
@click.option(
    "--crops",
    type=click.Path(path_type=Path),
    help=(
        "Folder of crops of python -m experiments.perception_lab.training, in place of"
        " new ones."
    ),
)
@click.option("--seed", default=0, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), required=True)
def sheet(*, maps: tuple[str, ...], crops: Path | None, seed: int, out: Path) -> None:
    """Forty pictures on one page."""
    if crops is not None and maps:
        raise click.UsageError("--crops: got it with --map; expected one of them")
    if crops is None:
        looks = draw_looks(_settings(maps), seed=seed)
    else:
        looks = stored_looks(crops, seed=seed)
    draw_sheet(looks, tell=_tell).save(out, quality=90)


@main.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option(
    "--detector", default="cnn", show_default=True, help="cnn, or an .onnx file."
)
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
