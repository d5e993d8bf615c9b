"""The model card: how well a network finds what it has not learnt, beside what is assumed."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from placement.detectors import Evidence, ResponseDetector, load_planning_detector

from .crops import CROP_PX, WEATHERS, Crops
from .metrics import Scored, average_precision, log_average_miss_rate, match_boxes
from .network import CLASSES, VruNetwork
from .train import Found, Recipe, class_of, counted, find_boxes

_PICTURE_PX = 1920 * 1080
_HEIGHTS_PX = (10.0, 20.0, 30.0, 50.0, 80.0, 1000.0)
_SHARES = (0.3, 0.65, 0.9, 1.01)
_LOOSE = 1.25  # boxes so much lower or higher than a group's still count as its false alarms
_MIN_CONFIDENCE = 0.5

_CARD = """\
# Model card: vru.onnx

A small network without anchors that finds pedestrians and cyclists in pictures drawn by this program.

* **Network**: {n_weights} weights; images of any size, RGB, 0 .. 1; boxes of what is visible of road users, in YOLO's layout.
* **Learnt from**: {n_crops} crops of {crop_px} x {crop_px} px, {n_labels} with a road user, drawn at {n_maps} junctions ({maps}),
  {drawings} drawings each: road users 11 to 125 px high, from poles and from cars, by day, at night and in rain, clothes,
  paints and facades at random. {steps} batches of {batch}, seed {seed}.
* **Tested on**: {n_tested} crops of junctions that it has never seen ({held_out}), with other clothes, paints and light.
* **Licence**: Apache-2.0, as the program; no photographs, no other network's weights.
* **Limits**: it knows only drawn pictures, at most one road user in a crop, three bodies (adult, child, cyclist). Nothing here
  tells how it would fare on photographs: do not use it in traffic.

Average precision (AP50) and log-average miss rate (over 0.01 to 1 false alarms per 1920 x 1080 picture's worth of pixels) at an
IoU above 0.5; found: share with a box of confidence {confidence:g} or more. The last column is what the response model assumes at full
contrast. What is less than 0.3 seen or lower than 10 px does not count. False alarms at confidence {confidence:g}: {alarms:.2f} per picture.

| road users | number | AP50 | log-average miss rate | found | response model |
| --- | --- | --- | --- | --- | --- |
{rows}
"""


def card_text(
    network: VruNetwork,
    learnt: Crops,
    tested: Mapping[str, Crops],
    *,
    names: Sequence[str],
    drawings: int,
    recipe: Recipe,
) -> str:
    """The card of a network as Markdown, measured on crops of junctions held out (by name)."""
    from .__main__ import join

    crops = join(list(tested.values()))
    found = find_boxes(network, crops)
    everything = _score(crops, found, np.ones(len(crops), dtype=bool))
    alarms = ~everything.is_true & (everything.confidence >= _MIN_CONFIDENCE)
    rows = [
        _row(name, crops, _score(crops, found, keep, heights), keep)
        for name, keep, heights in _groups(crops)
    ]
    return _CARD.format(
        n_weights=sum(weights.numel() for weights in network.parameters()),
        n_crops=len(learnt),
        crop_px=CROP_PX,
        n_labels=int((learnt.vru_class >= 0).sum()),
        n_maps=len(names),
        maps=", ".join(names),
        drawings=drawings,
        steps=recipe.steps,
        batch=recipe.batch,
        seed=recipe.seed,
        n_tested=len(crops),
        held_out=", ".join(name.rsplit("/", 1)[-1] for name in tested),
        confidence=_MIN_CONFIDENCE,
        alarms=alarms.sum() / everything.n_pictures,
        rows="\n".join(row for row in rows if row),
    )


def _groups(
    crops: Crops,
) -> Iterator[tuple[str, NDArray[np.bool_], tuple[float, float]]]:
    """Name, crops (n,), and heights of each group."""
    anything = (0.0, np.inf)
    height = crops.box_px[:, 3] - crops.box_px[:, 1]
    yield "all", np.ones(len(crops), dtype=bool), anything
    for number, name in enumerate(("adults", "children", "cyclists")):
        yield name, crops.vru_class == number, anything
    for low, high in zip(_HEIGHTS_PX[:-1], _HEIGHTS_PX[1:], strict=True):
        name = f"{low:g} to {high:g} px" if high < _HEIGHTS_PX[-1] else f"{low:g} px and more"
        yield name, (height >= low) & (height < high), (low, high)
    for low, high in zip(_SHARES[:-1], _SHARES[1:], strict=True):
        seen = (crops.visible_share >= low) & (crops.visible_share < high)
        yield f"{low:g} to {min(high, 1.0):g} seen", seen, anything
    for number, name in enumerate(WEATHERS):
        yield name, crops.weather == number, anything


def _row(name: str, crops: Crops, scored: Scored, keep: NDArray[np.bool_]) -> str:
    if not scored.n_labels:
        return ""
    share = (scored.is_true & (scored.confidence >= _MIN_CONFIDENCE)).sum() / scored.n_labels
    figures = (
        f"{average_precision(scored):.3f}",
        f"{100.0 * log_average_miss_rate(scored):.1f} %",
        f"{100.0 * share:.1f} %",
        f"{100.0 * _assumed(crops, keep & counted(crops)):.1f} %",
    )
    return f"| {name} | {scored.n_labels} | {' | '.join(figures)} |"


def _assumed(crops: Crops, keep: NDArray[np.bool_]) -> float:
    """Mean probability of the response model at full contrast, from the side."""
    response = load_planning_detector("response")
    assert isinstance(response, ResponseDetector)
    n = int(keep.sum())
    evidence = Evidence(
        visible_px=crops.box_px[keep],
        amodal_px=crops.box_px[keep],
        contrast=np.ones(n),
        visible_share=np.minimum(crops.visible_share[keep], 1.0),
        inside_share=np.ones(n),
        aspect_deg=np.full(n, 90.0),
        vru_class=crops.vru_class[keep],
        draw_index=np.arange(n),
    )
    return float(response.probability(evidence).mean())


def _score(
    crops: Crops,
    found: Found,
    keep: NDArray[np.bool_],
    heights_px: tuple[float, float] = (0.0, np.inf),
) -> Scored:
    """How boxes match the labels of crops in `keep` (n,), both classes together."""
    low, high = heights_px[0] / _LOOSE, heights_px[1] * _LOOSE
    nothing, counts = np.zeros((0, 4)), keep & counted(crops)
    parts = []
    for number in range(len(CLASSES)):
        own = class_of(crops) == number
        boxes, sure = [], []
        for by_class in found:
            height = by_class[number][0][:, 3] - by_class[number][0][:, 1]
            in_range = (height >= low) & (height <= high)
            boxes.append(by_class[number][0][in_range])
            sure.append(by_class[number][1][in_range])
        parts.append(
            match_boxes(
                boxes,
                sure,
                [box[None] if is_own else nothing for box, is_own in zip(crops.box_px, own, strict=True)],
                [counts[[row]] if is_own else np.zeros(0, dtype=bool) for row, is_own in enumerate(own)],
                min_iou=0.5,
                n_pictures=len(crops) * CROP_PX**2 / _PICTURE_PX,
            )
        )
    confidence = np.concatenate([part.confidence for part in parts])
    order = np.argsort(-confidence, kind="stable")
    return Scored(
        confidence=confidence[order],
        is_true=np.concatenate([part.is_true for part in parts])[order],
        label=np.concatenate([part.label for part in parts])[order],
        n_labels=sum(part.n_labels for part in parts),
        n_pictures=parts[0].n_pictures,
    )
