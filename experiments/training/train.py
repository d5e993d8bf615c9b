"""Train the detector that is shipped: ``python -m experiments.training.train MAP...``.

Draws labelled crops at the largest junction of each map (kept in the folder, so that a second call
trains at once), trains on all but those held out, tests on these, and writes ``vru.onnx`` with its
card. Needs the extra ``train``.
"""

import json
import math
from pathlib import Path
from typing import Any

import click
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from geometry.image_boxes import iou
from placement.detectors.network import suppress

from .crops import CROP_PX, Crops, load_crops
from .metrics import Scored, average_precision, log_average_miss_rate, match_boxes
from .network import CLASSES, VruNetwork, export_onnx, loss, to_boxes

_BATCH = 64
_RATE = 3.0e-3  # highest rate of learning
_DECAY = 1.0e-2
_LEAST_SHARE, _LEAST_PX = 0.3, 10.0  # what is hidden more, or is lower, neither counts nor harms
_MIN_CONFIDENCE = 0.02
_PICTURE_PX = 1920 * 1080


def train(crops: Crops, *, epochs: int, seed: int, tell: Any) -> VruNetwork:
    """Train a network on crops; the same seed gives the same network on the same machine."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    network = VruNetwork()
    steps = math.ceil(len(crops) / _BATCH)
    optimiser = torch.optim.AdamW(network.parameters(), lr=_RATE, weight_decay=_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, max_lr=_RATE, total_steps=epochs * steps, pct_start=0.15
    )
    network.train()
    for epoch in range(epochs):
        order, total = rng.permutation(len(crops)), 0.0
        for part in np.array_split(order, steps):
            images, boxes, classes, counts = _batch(crops, part, rng)
            value = loss(*network(images), boxes, classes, counts)
            optimiser.zero_grad()
            value.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(network.parameters(), 10.0)
            optimiser.step()
            schedule.step()
            total += float(value.detach())
        tell(epoch + 1, total / steps)
    return network.eval()


def counted(crops: Crops) -> NDArray[np.bool_]:
    """Crops whose road user counts, (n,)."""
    height = crops.box_px[:, 3] - crops.box_px[:, 1]
    is_clear: NDArray[np.bool_] = (
        (crops.vru_class >= 0) & (crops.visible_share >= _LEAST_SHARE) & (height >= _LEAST_PX)
    )
    return is_clear


def _class_of(crops: Crops) -> NDArray[np.int64]:
    """Index into ``CLASSES``; a child is a pedestrian; -1 where there is nobody."""
    return np.where(crops.vru_class < 0, -1, (crops.vru_class == 2).astype(np.int64))


def _batch(
    crops: Crops, part: NDArray[np.int64], rng: np.random.Generator
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Images with other light, noise and sharpness, half of them mirrored, and their labels."""
    images = crops.rgb[part].astype(np.float32) / 255.0
    boxes = crops.box_px[part].astype(np.float32).copy()
    n = len(part)
    mirrored = rng.random(n) < 0.5
    images[mirrored] = images[mirrored, :, ::-1]
    boxes[mirrored] = boxes[mirrored][:, [2, 1, 0, 3]]
    boxes[mirrored, 0::2] = CROP_PX - boxes[mirrored, 0::2]
    shape = (n, 1, 1, 1)
    grey = images.mean(axis=3, keepdims=True)
    colour = rng.uniform(0.3, 1.4, shape).astype(np.float32)
    images = grey + colour * (images - grey)
    mean = images.mean(axis=(1, 2, 3), keepdims=True)
    images = mean + rng.uniform(0.6, 1.3, shape).astype(np.float32) * (images - mean)
    images *= rng.uniform(0.6, 1.4, (n, 1, 1, 3)).astype(np.float32) ** 0.5
    images += rng.uniform(-0.08, 0.08, shape).astype(np.float32)
    noise = rng.exponential(0.015, shape).astype(np.float32)
    images += noise * rng.standard_normal(images.shape, dtype=np.float32)
    blurred = rng.random(n) < 0.25
    soft = images[blurred]
    soft[:, 1:-1] = (soft[:, :-2] + 2.0 * soft[:, 1:-1] + soft[:, 2:]) / 4.0
    soft[:, :, 1:-1] = (soft[:, :, :-2] + 2.0 * soft[:, :, 1:-1] + soft[:, :, 2:]) / 4.0
    images[blurred] = soft
    images = np.clip(images, 0.0, 1.0)
    return (
        torch.from_numpy(np.ascontiguousarray(images.transpose(0, 3, 1, 2))),
        torch.from_numpy(boxes),
        torch.from_numpy(_class_of(crops)[part]),
        torch.from_numpy(counted(crops)[part]),
    )


@torch.no_grad()
def find_boxes(
    network: VruNetwork, crops: Crops
) -> list[list[tuple[NDArray[np.float64], NDArray[np.float64]]]]:
    """Boxes and confidence of each crop, by class."""
    found = []
    for part in np.array_split(np.arange(len(crops)), math.ceil(len(crops) / 128)):
        pixels = torch.from_numpy(crops.rgb[part].transpose(0, 3, 1, 2).astype(np.float32) / 255.0)
        logits, sides = network(pixels)
        scores, boxes = logits.sigmoid().flatten(2).numpy(), to_boxes(sides).flatten(2).numpy()
        for row in range(len(part)):
            by_class = []
            for number in range(len(CLASSES)):
                sure = scores[row, number].astype(np.float64)
                order = np.argsort(-sure, kind="stable")
                order = order[sure[order] >= _MIN_CONFIDENCE]
                corners = boxes[row].T[order].astype(np.float64).clip(0.0, CROP_PX)
                kept = suppress(corners, np.zeros(len(order), dtype=np.int64), max_iou=0.5)
                by_class.append((corners[kept], sure[order][kept]))
            found.append(by_class)
    return found


def score(crops: Crops, found: Any, number: int, keep: NDArray[np.bool_]) -> Scored:
    """How boxes of a class match the labels; only labels in `keep` (n,) count."""
    own = _class_of(crops) == number
    return match_boxes(
        [by_class[number][0] for by_class in found],
        [by_class[number][1] for by_class in found],
        [box[None] if is_own else np.zeros((0, 4)) for box, is_own in zip(crops.box_px, own, strict=True)],
        [np.array([k]) if is_own else np.zeros(0, dtype=bool) for k, is_own in zip(keep, own, strict=True)],
        min_iou=0.5,
        n_pictures=len(crops) * CROP_PX**2 / _PICTURE_PX,
    )
