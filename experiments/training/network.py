"""A small network that finds pedestrians and cyclists, without anchors: layers, losses, export.

One picture cell of 8 x 8 pixels says, for each of two classes, how sure it is that a road user's
middle lies near, and how far away the four sides of its visible box are.

References
----------
.. [1] Z. Tian et al., "FCOS: Fully Convolutional One-Stage Object Detection", ICCV 2019: boxes as
   distances to four sides, positive cells near the middle.
.. [2] T.-Y. Lin et al., "Focal Loss for Dense Object Detection", ICCV 2017.
.. [3] H. Rezatofighi et al., "Generalized Intersection over Union", CVPR 2019.
"""

from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional as F

CLASSES = ("pedestrian", "cyclist")
STRIDE_PX = 8
_WIDTHS = (16, 24, 48, 80)  # channels at 1/2, 1/4, 1/8 and 1/16 of the size
_BLOCKS = (0, 1, 2, 3)
_PRIOR = 0.01  # of a road user in a cell, before training
_ALPHA, _GAMMA = 0.25, 2.0  # of the focal loss, as published
_RADIUS = 1.25  # cells around a middle that are positive
_UNIT_PX = 16.0  # distances are learnt in units of so many pixels


def _conv(n_in: int, n_out: int, *, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(n_in, n_out, 3, stride=stride, padding=1, bias=False),
        nn.BatchNorm2d(n_out),
        nn.ReLU(inplace=True),
    )


class _Block(nn.Module):
    """Two convolutions beside a short cut."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.second = _conv(width, width), _conv(width, width)

    def forward(self, features: Tensor) -> Tensor:
        """Same shape."""
        after: Tensor = self.second(self.first(features))
        return features + after


class VruNetwork(nn.Module):
    """From images (b, 3, h, w), 0 .. 1, sides multiples of 16, to class logits and distances."""

    def __init__(self) -> None:
        super().__init__()
        stages, n_in = [], 3
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
        """Logits (b, 2, h / 8, w / 8) and distances to the sides (b, 4, ..) in pixels."""
        features, levels = images, []
        for stage in self.stages:
            features = stage(features)
            levels.append(features)
        coarse = F.interpolate(levels[3], scale_factor=2.0, mode="nearest")
        merged = self.tower(self.merge(torch.cat([levels[2], coarse], dim=1)))
        return self.classes(merged), _UNIT_PX * F.softplus(self.sides(merged))


class ExportedNetwork(nn.Module):
    """The network as it is shipped: rows of middle, size and a score per class, (1, 6, n)."""

    def __init__(self, network: VruNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> Tensor:
        """Boxes are in pixels of the images."""
        logits, sides = self.network(images)
        boxes = to_boxes(sides)
        size = boxes[:, 2:] - boxes[:, :2]
        rows = torch.cat([0.5 * (boxes[:, :2] + boxes[:, 2:]), size, logits.sigmoid()], dim=1)
        return rows.flatten(2)


def cell_middles(height: int, width: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Columns (1, w) and rows (h, 1) of the cells' middles, in pixels."""
    across = (torch.arange(width, device=device) + 0.5) * STRIDE_PX
    down = (torch.arange(height, device=device) + 0.5) * STRIDE_PX
    return across[None, :], down[:, None]


def to_boxes(sides: Tensor) -> Tensor:
    """Corners (b, 4, h, w) of distances to the left, upper, right and lower side."""
    across, down = cell_middles(sides.shape[2], sides.shape[3], sides.device)
    left, top, right, bottom = sides.unbind(dim=1)
    return torch.stack([across - left, down - top, across + right, down + bottom], dim=1)


def loss(logits: Tensor, sides: Tensor, boxes: Tensor, classes: Tensor, counts: Tensor) -> Tensor:
    """Focal loss of the classes, and that of the overlap of boxes in positive cells.

    Parameters
    ----------
    logits, sides : Tensor
        What the network says.
    boxes : (b, 4) Tensor
        The visible box in each image, in pixels.
    classes : (b,) Tensor
        Its class; -1 where there is none.
    counts : (b,) Tensor of bool
        Whether the box counts; where a road user is hardly to be seen, cells on it do not.
    """
    n_images, n_classes, height, width = logits.shape
    across, down = cell_middles(height, width, logits.device)
    x_min, y_min, x_max, y_max = (side[:, None, None] for side in boxes.unbind(dim=1))
    has_box = (classes >= 0)[:, None, None]
    inside = (across > x_min) & (across < x_max) & (down > y_min) & (down < y_max) & has_box
    reach = _RADIUS * STRIDE_PX
    near = ((across - 0.5 * (x_min + x_max)).abs() < reach) & (
        (down - 0.5 * (y_min + y_max)).abs() < reach
    )
    # Boxes narrower than a cell may hold no cell's middle: the cell around theirs is positive.
    holds = ((across - 0.5 * (x_min + x_max)).abs() <= 0.5 * STRIDE_PX) & (
        (down - 0.5 * (y_min + y_max)).abs() <= 0.5 * STRIDE_PX
    )
    positive = ((inside & near) | (holds & has_box)) & counts[:, None, None]
    target = (
        F.one_hot(classes.clamp(min=0), n_classes).permute(0, 1)[:, :, None, None]
        * positive[:, None]
    )
    unsure = (inside & ~positive)[:, None].expand_as(logits)
    n_positive = positive.sum().clamp(min=1)
    target = target.float()
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
    low, high = (
        torch.maximum(first[:, :2], second[:, :2]),
        torch.minimum(first[:, 2:], second[:, 2:]),
    )
    common = (high - low).clamp(min=0.0).prod(dim=1)
    area = [(box[:, 2:] - box[:, :2]).prod(dim=1) for box in (first, second)]
    union = area[0] + area[1] - common
    around = torch.maximum(first[:, 2:], second[:, 2:]) - torch.minimum(first[:, :2], second[:, :2])
    hull = around.prod(dim=1)
    value: Tensor = common / union.clamp(min=1e-6) - (hull - union) / hull.clamp(min=1e-6)
    return value


def export_onnx(network: VruNetwork, path: Path, *, side_px: int) -> None:
    """Write the network for images of any size whose sides are multiples of 16 pixels."""
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
