"""Training of the detector that is shipped, on crops whose labels are known.

One network is trained on crops of several junctions; half of them mirrored, all of them with other
light, colour, noise and sharpness each time they are shown.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.optim.swa_utils import AveragedModel

from placement.detectors.network import suppress

from .crops import CROP_PX, Crops
from .network import CLASSES, VruNetwork, loss, to_boxes

_RATE = 3.0e-3  # highest rate of learning
_DECAY = 1.0e-2
_MEMORY = 0.998  # of the running mean of weights, which is what is kept
_LEAST_SHARE, _LEAST_PX = 0.3, 10.0  # what is hidden more, or is lower, neither counts nor harms
_LEAST_SPREAD = 3.0  # of grey, 0 .. 255: what stands out less cannot be learnt
_MIN_CONFIDENCE = 0.02
_MOST_AT_ONCE = 128
_GRAIN = np.random.default_rng(0).standard_normal(2**21, dtype=np.float32)  # noise of sensors

Found = list[list[tuple[NDArray[np.float64], NDArray[np.float64]]]]
"""By crop and class: boxes (n, 4) and their confidence (n,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """How a network is trained; the same recipe and crops give the same network on a machine."""

    steps: int  # batches shown
    seed: int
    batch: int = 64
    round_steps: int = 250  # after so many the state is kept, and told
    bfloat16: bool = False  # multiply in 16 bits: twice as fast on processors that can
    device: str = "cpu"

    @property
    def rounds(self) -> int:
        """How often the state is kept; the last round may be shorter."""
        return math.ceil(self.steps / self.round_steps)


def train(
    crops: Crops | Callable[[], Crops],
    recipe: Recipe,
    *,
    tell: Callable[[int, float, VruNetwork], None] = lambda done, loss, network: None,
    checkpoint: Path | None = None,
) -> VruNetwork:
    """Train a network on crops.

    Parameters
    ----------
    crops : Crops or callable
        What it learns from; a callable is asked before each round.
    recipe : Recipe
        How.
    tell : callable
        Is told after each round: steps done, its mean loss, and the network so far.
    checkpoint : Path, optional
        Where the state is kept after each round; training goes on from there if it exists.

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
    first = _restore(checkpoint, parts)
    for _ in range(first * recipe.round_steps):
        schedule.step()
    for number in range(first, recipe.rounds):
        network.train()
        rng = np.random.default_rng([recipe.seed, number])
        shown = crops() if callable(crops) else crops
        labels, losses = _labels(shown), []
        done = number * recipe.round_steps
        for part in _draw_rows(
            len(shown), min(recipe.round_steps, recipe.steps - done), recipe.batch, rng
        ):
            images, *truth = (one.to(recipe.device) for one in _batch(shown, labels, part, rng))
            with torch.autocast(recipe.device, dtype=torch.bfloat16, enabled=recipe.bfloat16):
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


# ---------- labels


def class_of(crops: Crops) -> NDArray[np.int64]:
    """Index into ``CLASSES`` (n,); a child is a pedestrian; -1 where there is nobody."""
    return np.where(crops.vru_class < 0, -1, (crops.vru_class == 2).astype(np.int64))


def counted(crops: Crops) -> NDArray[np.bool_]:
    """Crops whose road user counts, (n,): at least 0.3 of it is seen, at least 10 px high."""
    height = crops.box_px[:, 3] - crops.box_px[:, 1]
    is_clear: NDArray[np.bool_] = (
        (crops.vru_class >= 0) & (crops.visible_share >= _LEAST_SHARE) & (height >= _LEAST_PX)
    )
    return is_clear


def _stands_out(crops: Crops) -> NDArray[np.bool_]:
    """Crops whose road user is more than noise in the dark, (n,)."""
    stands = np.zeros(len(crops), dtype=bool)
    for row in np.flatnonzero(crops.vru_class >= 0).tolist():
        left, top, right, bottom = crops.box_px[row].astype(int)
        grey = crops.rgb[row, max(top - 2, 0) : bottom + 2, max(left - 2, 0) : right + 2].mean(
            axis=2
        )
        high, wide = (side // 2 * 2 for side in grey.shape)
        coarse = grey[:high, :wide].reshape(high // 2, 2, wide // 2, 2).mean(axis=(1, 3))
        stands[row] = coarse.std() >= _LEAST_SPREAD
    return stands


def _labels(crops: Crops) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    return class_of(crops), counted(crops) & _stands_out(crops)


def _batch(
    crops: Crops,
    labels: tuple[NDArray[np.int64], NDArray[np.bool_]],
    part: NDArray[np.int64],
    rng: np.random.Generator,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Images with other light, noise and sharpness, half of them mirrored, and their labels."""
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
        torch.from_numpy(images).permute(0, 3, 1, 2),  # channels last
        torch.from_numpy(boxes),
        torch.from_numpy(classes[part]),
        torch.from_numpy(counts[part]),
    )


def _other_colours(images: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """Images (n, h, w, 3) with another saturation, contrast, tint and lightness each."""

    def draw(low: float, high: float, n_channels: int = 1) -> NDArray[np.float32]:
        return rng.uniform(low, high, (len(images), 1, n_channels)).astype(np.float32)

    colour, contrast = draw(0.3, 1.4), draw(0.6, 1.3)
    tint = draw(0.6, 1.4, 3) ** np.float32(0.5)
    mean = images.mean(axis=(1, 2, 3), dtype=np.float32)[:, None, None]
    mixed = colour * np.eye(3, dtype=np.float32) + (1.0 - colour) / np.float32(3.0)
    pixels = images.reshape(len(images), -1, 3) @ (contrast * mixed * tint)
    pixels += (1.0 - contrast) * mean * tint + draw(-0.08, 0.08)
    return pixels.reshape(images.shape)


# ---------- what a network finds


@torch.no_grad()
def find_boxes(network: VruNetwork, crops: Crops) -> Found:
    """Boxes and confidence of each crop, by class, overlapping ones suppressed."""
    found: Found = []
    for part in np.array_split(np.arange(len(crops)), math.ceil(len(crops) / _MOST_AT_ONCE)):
        pixels = torch.from_numpy(crops.rgb[part].transpose(0, 3, 1, 2).astype(np.float32) / 255.0)
        logits, sides = network(pixels)
        scores, boxes = logits.sigmoid().flatten(2).numpy(), to_boxes(sides).flatten(2).numpy()
        for row in range(len(part)):
            found.append([_kept(boxes[row], scores[row, number]) for number in range(len(CLASSES))])
    return found


def _kept(
    boxes: NDArray[np.float32], scores: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    sure = scores.astype(np.float64)
    order = np.argsort(-sure, kind="stable")
    order = order[sure[order] >= _MIN_CONFIDENCE]
    corners = boxes.T[order].astype(np.float64).clip(0.0, CROP_PX)
    kept = suppress(corners, np.zeros(len(order), dtype=np.int64), max_iou=0.5)
    return corners[kept], sure[order][kept]
