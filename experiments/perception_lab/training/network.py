"""A small network that finds pedestrians and cyclists.

Layers, losses, training, export.

Without anchors: one picture cell of 8 x 8 pixels says, for each of two classes, how
sure it is that a road user's middle lies near, and how far away the four sides of its
visible box are. It is trained on crops of several junctions; half of them mirrored, all
of them with other light, colour, noise and sharpness each time they are shown.

References
----------
.. [1] Z. Tian et al., "FCOS: Fully Convolutional One-Stage Object Detection", ICCV
   2019: boxes as
   distances to four sides, positive cells near the middle.
.. [2] T.-Y. Lin et al., "Focal Loss for Dense Object Detection", ICCV 2017.
.. [3] H. Rezatofighi et al., "Generalized Intersection over Union", CVPR 2019.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F
from torch.optim.swa_utils import AveragedModel

from geometry.image_boxes import box_height_px
from placement.detectors.network import suppress

from .crops import CROP_PX, LabelledCrops

CLASSES = ("pedestrian", "cyclist")
STRIDE_PX = 8
# Channels at 1/2, 1/4, 1/8 and 1/16 of the size.
_WIDTHS = (16, 24, 48, 80)
_BLOCKS = (0, 1, 2, 3)
# Of a road user in a cell, before training.
_PRIOR = 0.01
_ALPHA = 0.25
# Of the focal loss, as published.
_GAMMA = 2.0
# Cells around a middle that are positive.
_RADIUS = 1.25
# Distances are learnt in units of so many pixels.
_UNIT_PX = 16.0


def _conv(n_in: int, n_out: int, *, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(n_in, n_out, 3, stride=stride, padding=1, bias=False),
        nn.BatchNorm2d(n_out),
        nn.ReLU(inplace=True),
    )


class _Block(nn.Module):
    """Two convolutions with a residual connection."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.second = _conv(width, width), _conv(width, width)

    def forward(self, features: Tensor) -> Tensor:
        """Same shape."""
        after: Tensor = self.second(self.first(features))
        return features + after


class VruNetwork(nn.Module):
    """From images (b, 3, h, w), 0 .

    1, sides multiples of 16, to class logits and distances.
    """

    def __init__(self) -> None:
        super().__init__()
        stages = []
        n_in = 3
        for width, n_blocks in zip(_WIDTHS, _BLOCKS, strict=True):
            blocks = [_Block(width) for _ in range(n_blocks)]
            stages.append(nn.Sequential(_conv(n_in, width, stride=2), *blocks))
            n_in = width
        self.stages = nn.ModuleList(stages)
        self.merge = _conv(_WIDTHS[2] + _WIDTHS[3], _WIDTHS[2])
        self.tower = _conv(_WIDTHS[2], _WIDTHS[2])
        self.classes = nn.Conv2d(_WIDTHS[2], len(CLASSES), 1)
        self.sides = nn.Conv2d(_WIDTHS[2], 4, 1)
        nn.init.constant_(
            self.classes.bias, -float(torch.log(torch.tensor((1.0 - _PRIOR) / _PRIOR)))
        )

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Logits (b, 2, h / 8, w / 8) and distances to sides (b, 4, ..) in px."""
        features = images
        levels = []
        for stage in self.stages:
            features = stage(features)
            levels.append(features)
        coarse = F.interpolate(levels[3], scale_factor=2.0, mode="nearest")
        merged = self.tower(self.merge(torch.cat([levels[2], coarse], dim=1)))
        return self.classes(merged), _UNIT_PX * F.softplus(self.sides(merged))


class ExportedNetwork(nn.Module):
    """The network as it is shipped.

    Rows of middle, size and a score per class, (1, 6, n).
    """

    def __init__(self, network: VruNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> Tensor:
        """Boxes are in pixels of the images."""
        logits, sides = self.network(images)
        boxes = to_boxes(sides)
        size = boxes[:, 2:] - boxes[:, :2]
        rows = torch.cat(
            [0.5 * (boxes[:, :2] + boxes[:, 2:]), size, logits.sigmoid()], dim=1
        )
        return rows.flatten(2)


def cell_middles(
    height: int, width: int, device: torch.device
) -> tuple[Tensor, Tensor]:
    """Columns (1, w) and rows (h, 1) of the cells' middles, in pixels."""
    across = (torch.arange(width, device=device) + 0.5) * STRIDE_PX
    down = (torch.arange(height, device=device) + 0.5) * STRIDE_PX
    return across[None, :], down[:, None]


def to_boxes(sides: Tensor) -> Tensor:
    """Corners (b, 4, h, w) of distances to the four sides.

    Left, upper, right and lower.
    """
    across, down = cell_middles(sides.shape[2], sides.shape[3], sides.device)
    left, top, right, bottom = sides.unbind(dim=1)
    return torch.stack(
        [across - left, down - top, across + right, down + bottom], dim=1
    )


def loss(
    logits: Tensor, sides: Tensor, boxes: Tensor, classes: Tensor, counts: Tensor
) -> Tensor:
    """Focal loss of the classes, and loss of the boxes' overlap.

    The latter in positive cells.

    Parameters
    ----------
    logits, sides : Tensor
        What the network says.
    boxes : (b, 4) Tensor
        The visible box in each image, in pixels.
    classes : (b,) Tensor
        Its class; -1 where there is none.
    counts : (b,) Tensor of bool
        Whether the box counts; where a road user is hardly to be seen, cells on it do
        not.
    """
    n_images, n_classes, height, width = logits.shape
    across, down = cell_middles(height, width, logits.device)
    x_min, y_min, x_max, y_max = (side[:, None, None] for side in boxes.unbind(dim=1))
    has_box = (classes >= 0)[:, None, None]
    inside = (
        (across > x_min) & (across < x_max) & (down > y_min) & (down < y_max) & has_box
    )
    reach = _RADIUS * STRIDE_PX
    beside = (across - 0.5 * (x_min + x_max)).abs()
    below = (down - 0.5 * (y_min + y_max)).abs()
    near = (beside < reach) & (below < reach)
    # Boxes narrower than a cell may hold no cell's middle: the cell around theirs is
    # positive.
    holds = (beside <= 0.5 * STRIDE_PX) & (below <= 0.5 * STRIDE_PX)
    positive = ((inside & near) | (holds & has_box)) & counts[:, None, None]
    one_hot = F.one_hot(classes.clamp(min=0), n_classes)[:, :, None, None]
    target = (one_hot * positive[:, None]).float()
    unsure = (inside & ~positive)[:, None].expand_as(logits)
    n_positive = positive.sum().clamp(min=1)
    entropy = F.binary_cross_entropy_with_logits(logits, target, reduction="none")
    right = torch.where(target > 0.5, logits.sigmoid(), 1.0 - logits.sigmoid())
    weight = torch.where(target > 0.5, _ALPHA, 1.0 - _ALPHA) * (1.0 - right) ** _GAMMA
    focal = (entropy * weight * ~unsure).sum() / n_positive
    if not bool(positive.any()):
        return focal
    found = to_boxes(sides).permute(0, 2, 3, 1)[positive]
    wanted = boxes[:, None, None].expand(n_images, height, width, 4)[positive]
    return focal + (1.0 - _generalised_iou(found, wanted)).mean()


def _generalised_iou(first: Tensor, second: Tensor) -> Tensor:
    low = torch.maximum(first[:, :2], second[:, :2])
    high = torch.minimum(first[:, 2:], second[:, 2:])
    common = (high - low).clamp(min=0.0).prod(dim=1)
    area = [(box[:, 2:] - box[:, :2]).prod(dim=1) for box in (first, second)]
    union = area[0] + area[1] - common
    around = torch.maximum(first[:, 2:], second[:, 2:]) - torch.minimum(
        first[:, :2], second[:, :2]
    )
    hull = around.prod(dim=1)
    value: Tensor = common / union.clamp(min=1e-6) - (hull - union) / hull.clamp(
        min=1e-6
    )
    return value


def export_onnx(network: VruNetwork, path: Path, *, side_px: int) -> None:
    """Write the network for images of any size.

    The sides are multiples of 16 pixels.
    """
    import onnx

    whole = ExportedNetwork(network).eval()
    torch.onnx.export(
        whole,
        (torch.zeros(1, 3, side_px, side_px),),
        str(path),
        input_names=["images"],
        output_names=["rows"],
        dynamic_axes={"images": {2: "height", 3: "width"}, "rows": {2: "n"}},
        opset_version=17,
        dynamo=False,
    )
    model = onnx.load(str(path))
    entry = model.metadata_props.add()
    entry.key, entry.value = "names", str(dict(enumerate(CLASSES)))
    onnx.save(model, str(path))


# Highest rate of learning.
_RATE = 3.0e-3
_DECAY = 1.0e-2
# Of the running mean of weights, which is exported.
_MEMORY = 0.998
_LEAST_SHARE = 0.3
# What is hidden more, or is lower, neither counts nor harms.
_LEAST_CROP_PX = 10.0
# Of grey, 0 .. 255: what stands out less cannot be learnt.
_LEAST_SPREAD = 3.0
_MIN_CONFIDENCE = 0.02
_MOST_AT_ONCE = 128
# Noise of sensors.
_GRAIN = np.random.default_rng(0).standard_normal(2**21, dtype=np.float32)

Found = list[list[tuple[NDArray[np.float64], NDArray[np.float64]]]]
"""By crop and class: boxes (n, 4) and their confidence (n,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """How a network is trained.

    The same recipe and crops give the same network on a machine.
    """

    # Batches shown.
    steps: int
    seed: int
    batch: int = 64
    # After so many the state is saved, and reported.
    round_steps: int = 250
    # Multiply in 16 bits: twice as fast on processors that can.
    bfloat16: bool = False
    device: str = "cpu"

    @property
    def rounds(self) -> int:
        """How often the state is saved; the last round may be shorter."""
        return math.ceil(self.steps / self.round_steps)


def train(
    crops: LabelledCrops,
    recipe: Recipe,
    *,
    tell: Callable[[int, float, VruNetwork], None] = lambda done, loss, network: None,
    checkpoint: Path | None = None,
) -> VruNetwork:
    """Train a network on crops.

    Parameters
    ----------
    crops : LabelledCrops or callable
        What it learns from; a callable is asked before each round.
    recipe : Recipe
        How.
    tell : callable
        Is told after each round: steps done, its mean loss, and the network so far.
    checkpoint : Path, optional
        Where the state is kept after each round; training goes on from there if it
        exists.

    Returns
    -------
    network : VruNetwork
        With the running mean of its weights, ready to look at images.
    """
    torch.manual_seed(recipe.seed)
    network = VruNetwork().to(recipe.device, memory_format=torch.channels_last)
    mean = AveragedModel(network, avg_fn=_running_mean, use_buffers=True)
    optimiser = torch.optim.AdamW(network.parameters(), lr=_RATE, weight_decay=_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, max_lr=_RATE, total_steps=recipe.steps, pct_start=0.15
    )
    parts = {"network": network, "mean": mean, "optimiser": optimiser}
    labels = class_of(crops), counted(crops) & _stands_out(crops)
    first = _restore(checkpoint, parts)
    for _ in range(first * recipe.round_steps):
        schedule.step()
    for number in range(first, recipe.rounds):
        network.train()
        rng = np.random.default_rng([recipe.seed, number])
        losses = []
        done = number * recipe.round_steps
        for part in _draw_rows(
            len(crops), min(recipe.round_steps, recipe.steps - done), recipe.batch, rng
        ):
            images, *truth = (
                one.to(recipe.device) for one in _batch(crops, labels, part, rng)
            )
            with torch.autocast(
                recipe.device, dtype=torch.bfloat16, enabled=recipe.bfloat16
            ):
                logits, sides = network(images)
            value = loss(logits.float(), sides.float(), *truth)
            optimiser.zero_grad()
            value.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), 10.0)
            optimiser.step()
            schedule.step()
            mean.update_parameters(network)
            losses.append(float(value.detach()))
        _keep(checkpoint, parts, number + 1)
        tell(done + len(losses), float(np.mean(losses)), _of(mean))
    return _of(mean)


def _running_mean(mean: Tensor, new: Tensor, n_averaged: Tensor | int) -> Tensor:
    """Mean of the latest weights; at first of all there have been."""
    memory = min(_MEMORY, (1.0 + float(n_averaged)) / (10.0 + float(n_averaged)))
    return mean + (1.0 - memory) * (new - mean)


def _draw_rows(
    n_crops: int, steps: int, batch: int, rng: np.random.Generator
) -> Iterator[NDArray[np.int64]]:
    """Rows of each batch; all crops are shown before one is shown again."""
    passes = math.ceil(steps * batch / n_crops)
    rows = np.concatenate([rng.permutation(n_crops) for _ in range(passes)])
    yield from rows[: steps * batch].reshape(steps, batch)


def _of(mean: AveragedModel) -> VruNetwork:
    """The network with the mean weights."""
    network = VruNetwork()
    network.load_state_dict(mean.module.state_dict())
    network.eval()
    return network


def _restore(checkpoint: Path | None, parts: dict[str, Any]) -> int:
    """Rounds that are done already."""
    if checkpoint is None or not checkpoint.exists():
        return 0
    state = torch.load(checkpoint, weights_only=True)
    for name, part in parts.items():
        part.load_state_dict(state[name])
    return int(state["rounds"])


def _keep(checkpoint: Path | None, parts: dict[str, Any], rounds: int) -> None:
    """Write the state, whole or not at all."""
    if checkpoint is None:
        return
    state = {name: part.state_dict() for name, part in parts.items()}
    new = checkpoint.with_suffix(".part")
    torch.save(state | {"rounds": rounds}, new)
    new.replace(checkpoint)


def class_of(crops: LabelledCrops) -> NDArray[np.int64]:
    """Index into ``CLASSES`` (n,).

    A child is a pedestrian; -1 where there is nobody.
    """
    return np.where(crops.vru_class < 0, -1, (crops.vru_class == 2).astype(np.int64))


def counted(crops: LabelledCrops) -> NDArray[np.bool_]:
    """Crops whose road user counts, (n,).

    At least 0.3 of it is seen, at least 10 px high.
    """
    is_high: NDArray[np.bool_] = box_height_px(crops.box_px) >= _LEAST_CROP_PX
    return is_high & (crops.vru_class >= 0) & (crops.visible_share >= _LEAST_SHARE)


def _stands_out(crops: LabelledCrops) -> NDArray[np.bool_]:
    """Crops whose road user is more than noise in the dark, (n,)."""
    stands = np.zeros(len(crops), dtype=bool)
    for row in np.flatnonzero(crops.vru_class >= 0).tolist():
        left, top, right, bottom = crops.box_px[row].astype(int)
        around = np.s_[row, max(top - 2, 0) : bottom + 2, max(left - 2, 0) : right + 2]
        grey = crops.rgb[around].mean(axis=2)
        high, wide = (side // 2 * 2 for side in grey.shape)
        coarse = (
            grey[:high, :wide].reshape(high // 2, 2, wide // 2, 2).mean(axis=(1, 3))
        )
        stands[row] = coarse.std() >= _LEAST_SPREAD
    return stands


def _batch(
    crops: LabelledCrops,
    labels: tuple[NDArray[np.int64], NDArray[np.bool_]],
    part: NDArray[np.int64],
    rng: np.random.Generator,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Images with other light, noise and sharpness, and their labels.

    Half of them are mirrored.
    """
    images = crops.rgb[part].astype(np.float32) / np.float32(255.0)
    boxes = crops.box_px[part].astype(np.float32)
    n = len(part)
    mirrored = rng.random(n) < 0.5
    images[mirrored] = images[mirrored, :, ::-1]
    boxes[mirrored] = boxes[mirrored][:, [2, 1, 0, 3]]
    boxes[mirrored, 0::2] = CROP_PX - boxes[mirrored, 0::2]
    images = _other_colours(images, rng)
    noise = rng.exponential(0.015, (n, 1, 1, 1)).astype(np.float32)
    starts = rng.integers(0, _GRAIN.size - images[0].size, n).tolist()
    for image, start, strength in zip(images, starts, noise, strict=True):
        image += strength * _GRAIN[start : start + image.size].reshape(image.shape)
    blurred = rng.random(n) < 0.25
    soft = images[blurred]
    soft[:, 1:-1] = (soft[:, :-2] + 2.0 * soft[:, 1:-1] + soft[:, 2:]) / 4.0
    soft[:, :, 1:-1] = (soft[:, :, :-2] + 2.0 * soft[:, :, 1:-1] + soft[:, :, 2:]) / 4.0
    images[blurred] = soft
    np.clip(images, 0.0, 1.0, out=images)
    classes, counts = labels
    return (
        # Channels last.
        torch.from_numpy(images).permute(0, 3, 1, 2),
        torch.from_numpy(boxes),
        torch.from_numpy(classes[part]),
        torch.from_numpy(counts[part]),
    )


def _other_colours(
    images: NDArray[np.float32], rng: np.random.Generator
) -> NDArray[np.float32]:
    """Images (n, h, w, 3), each with other colours and lightness.

    Saturation, contrast and tint are drawn.
    """

    def draw(low: float, high: float, n_channels: int = 1) -> NDArray[np.float32]:
        return rng.uniform(low, high, (len(images), 1, n_channels)).astype(np.float32)

    colour = draw(0.3, 1.4)
    contrast = draw(0.6, 1.3)
    tint = draw(0.6, 1.4, 3) ** np.float32(0.5)
    mean = images.mean(axis=(1, 2, 3), dtype=np.float32)[:, None, None]
    mixed = colour * np.eye(3, dtype=np.float32) + (1.0 - colour) / np.float32(3.0)
    pixels = images.reshape(len(images), -1, 3) @ (contrast * mixed * tint)
    pixels += (1.0 - contrast) * mean * tint + draw(-0.08, 0.08)
    return pixels.reshape(images.shape)


@torch.no_grad()
def find_boxes(network: VruNetwork, crops: LabelledCrops) -> Found:
    """Boxes and confidence of each crop by class, without overlapping ones."""
    found: Found = []
    for part in np.array_split(
        np.arange(len(crops)), math.ceil(len(crops) / _MOST_AT_ONCE)
    ):
        pixels = torch.from_numpy(
            crops.rgb[part].transpose(0, 3, 1, 2).astype(np.float32) / 255.0
        )
        logits, sides = network(pixels)
        scores = logits.sigmoid().flatten(2).numpy()
        boxes = to_boxes(sides).flatten(2).numpy()
        for row in range(len(part)):
            found.append(
                [
                    _most_confident(boxes[row], scores[row, number])
                    for number in range(len(CLASSES))
                ]
            )
    return found


def _most_confident(
    boxes: NDArray[np.float32], scores: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    sure = scores.astype(np.float64)
    order = np.argsort(-sure, kind="stable")
    order = order[sure[order] >= _MIN_CONFIDENCE]
    corners = boxes.T[order].astype(np.float64).clip(0.0, CROP_PX)
    left = suppress(corners, np.zeros(len(order), dtype=np.int64), max_iou=0.5)
    return corners[left], sure[order][left]
