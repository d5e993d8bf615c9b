"""Model card and response table of a network.

By what it finds in crops of junctions held out.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.resources import files
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from geometry.image_boxes import box_height_px
from geometry.weather import pick_weather
from placement.compute import Compute
from placement.detectors import Evidence
from placement.detectors.evidence import Interval
from placement.detectors.fitting import LabelledPicture, fit_response, gather_sightings
from placement.detectors.response import ResponseDetector, built_in_response

from ..fit import table_text
from .crops import CROP_PX, WEATHERS, LabelledCrops
from .metrics import Scored, average_precision, log_average_miss_rate, match_boxes
from .network import CLASSES, Found, Recipe, VruNetwork, class_of, counted

_PICTURE_PX = 1920 * 1080
_HEIGHTS_PX = (10.0, 20.0, 30.0, 50.0, 80.0, 1000.0)
_SHARES = (0.3, 0.65, 0.9, 1.01)
# boxes so much lower or higher than a group's still count as its false alarms
_LOOSE = 1.25
MIN_CONFIDENCE = 0.5
"""From which on boxes count."""


def card_text(
    network: VruNetwork,
    learnt: LabelledCrops,
    crops: LabelledCrops,
    found: Found,
    *,
    held_out: Sequence[str],
    names: Sequence[str],
    recipe: Recipe,
) -> str:
    """The card of a network as Markdown.

    By what it `found` in crops of junctions held out.
    """
    everything = _score(crops, found, np.ones(len(crops), dtype=bool))
    alarms = ~everything.is_true & (everything.confidence >= MIN_CONFIDENCE)
    rows = [
        _row(name, crops, _score(crops, found, keep, heights), keep)
        for name, keep, heights in _groups(crops)
    ]
    template = (files(__package__) / "card.md").read_text(encoding="utf-8")
    return template.format(
        n_weights=sum(weights.numel() for weights in network.parameters()),
        n_crops=len(learnt),
        crop_px=CROP_PX,
        n_labels=int((learnt.vru_class >= 0).sum()),
        n_maps=len(names),
        maps=", ".join(names),
        steps=recipe.steps,
        batch=recipe.batch,
        seed=recipe.seed,
        n_tested=len(crops),
        held_out=", ".join(held_out),
        confidence=MIN_CONFIDENCE,
        alarms=alarms.sum() / everything.n_pictures,
        rows="\n".join(row for row in rows if row),
    )


def _groups(
    crops: LabelledCrops,
) -> Iterator[tuple[str, NDArray[np.bool_], tuple[float, float]]]:
    """Name, crops (n,), and heights of each group."""
    anything = (0.0, np.inf)
    height = box_height_px(crops.box_px)
    yield "all", np.ones(len(crops), dtype=bool), anything
    for number, name in enumerate(("adults", "children", "cyclists")):
        yield name, crops.vru_class == number, anything
    for low, high in pairwise(_HEIGHTS_PX):
        if high < _HEIGHTS_PX[-1]:
            name = f"{low:g} to {high:g} px"
        else:
            name = f"{low:g} px and more"
        yield name, (height >= low) & (height < high), (low, high)
    for low, high in pairwise(_SHARES):
        seen = (crops.visible_share >= low) & (crops.visible_share < high)
        yield f"{low:g} to {min(high, 1.0):g} seen", seen, anything
    for number, name in enumerate(WEATHERS):
        yield name, crops.weather == number, anything


def _row(
    name: str, crops: LabelledCrops, scored: Scored, keep: NDArray[np.bool_]
) -> str:
    if not scored.n_labels:
        return ""
    share = (
        scored.is_true & (scored.confidence >= MIN_CONFIDENCE)
    ).sum() / scored.n_labels
    shares = (
        log_average_miss_rate(scored),
        share,
        _assumed(crops, keep & counted(crops)),
    )
    figures = [
        f"{average_precision(scored):.3f}",
        *(f"{100.0 * one:.1f} %" for one in shares),
    ]
    return f"| {name} | {scored.n_labels} | {' | '.join(figures)} |"


def _assumed(crops: LabelledCrops, keep: NDArray[np.bool_]) -> float:
    """Mean probability of the response model at full contrast, from the side."""
    n = int(keep.sum())
    evidence = Evidence(
        visible_px=crops.box_px[keep],
        amodal_px=crops.box_px[keep],
        visible_share=np.minimum(crops.visible_share[keep], 1.0),
        aspect_deg=np.full(n, 90.0),
        vru_class=crops.vru_class[keep],
        draw_index=np.arange(n),
    )
    return float(built_in_response().probability(evidence).mean())


def _score(
    crops: LabelledCrops,
    found: Found,
    keep: NDArray[np.bool_],
    heights_px: tuple[float, float] = (0.0, np.inf),
) -> Scored:
    """How boxes match the labels of crops, both classes together.

    Of the crops in `keep` (n,).
    """
    low = heights_px[0] / _LOOSE
    high = heights_px[1] * _LOOSE
    counts = keep & counted(crops)
    parts = []
    for number in range(len(CLASSES)):
        own = [
            slice(row, row + is_own)
            for row, is_own in enumerate(class_of(crops) == number)
        ]
        boxes = []
        sure = []
        for by_class in found:
            height = box_height_px(by_class[number][0])
            in_range = (height >= low) & (height <= high)
            boxes.append(by_class[number][0][in_range])
            sure.append(by_class[number][1][in_range])
        labels = [crops.box_px[rows] for rows in own], [counts[rows] for rows in own]
        n_pictures = len(crops) * CROP_PX**2 / _PICTURE_PX
        parts.append(
            match_boxes(boxes, sure, *labels, min_iou=0.5, n_pictures=n_pictures)
        )
    confidence = np.concatenate([part.confidence for part in parts])
    order = np.argsort(-confidence, kind="stable")
    return Scored(
        confidence=confidence[order],
        is_true=np.concatenate([part.is_true for part in parts])[order],
        n_labels=sum(part.n_labels for part in parts),
        n_pictures=parts[0].n_pictures,
    )


_LEAST_LABEL_PX = 8.0
_UNKNOWN = ("aspect", "frame_correlation")


def fit_table(
    crops: LabelledCrops, found: Found, *, source: str, command: str, compute: Compute
) -> str:
    """Response table as TOML, for ``--detector FILE``.

    Each crop is a track of its own.

    `found` has boxes and confidence of each crop, by class; `source` and `command` say
    what the crops are of, and how this was called.
    """
    pictures = [_picture(crops, row, by_class) for row, by_class in enumerate(found)]
    sightings, _ = gather_sightings(pictures, n_confirmations=3, frame_rate_hz=10.0)
    fit = fit_response(sightings, name="vru.toml", seed=compute.seed)
    keys = ("cyclist_end_on", "frame_correlation")
    builtins = {key: getattr(built_in_response(), key) for key in keys}
    intervals = {key: Interval(value, value, value) for key, value in builtins.items()}
    detector: ResponseDetector = replace(fit.detector, **builtins)
    fit = replace(fit, detector=detector, intervals={**fit.intervals, **intervals})
    return table_text(
        fit,
        source=source,
        command=command,
        unknown=_UNKNOWN,
        false_tracks_per_hour=None,
    )


def _picture(
    crops: LabelledCrops, row: int, by_class: list[tuple[np.ndarray, np.ndarray]]
) -> LabelledPicture:
    """A crop, its label if large enough, and the boxes that count for it."""
    kind = int(crops.vru_class[row])
    box = crops.box_px[row]
    n_labels = int(kind >= 0 and box[3] - box[1] >= _LEAST_LABEL_PX)
    sure = [boxes[confidence >= MIN_CONFIDENCE] for boxes, confidence in by_class]
    # A cyclist may be found as a person, as in an evaluation.
    if kind == 2:
        own = np.concatenate(sure)
    else:
        own = sure[0]
    weather = pick_weather(WEATHERS[int(crops.weather[row])], "weather")
    return LabelledPicture(
        track=row,
        frame=0,
        label_px=box[None][:n_labels],
        label_class=np.full(n_labels, kind),
        seen_share=np.full(n_labels, min(crops.visible_share[row], 1.0)),
        contrast=np.full(n_labels, weather.contrast),
        aspect_deg=np.full(n_labels, 90.0),
        found_px=own,
        is_whole=False,
    )
