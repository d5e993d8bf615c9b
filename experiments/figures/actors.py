"""Every body from eight sides: ``python -m experiments.figures.actors --out FILE.png``."""

from collections.abc import Mapping
from pathlib import Path

import click
import numpy as np
from matplotlib.axes import Axes

from geometry.actors import Actor, Shape, load_actors
from geometry.arrays import FloatArray
from geometry.files import write_atomically
from geometry.poses import body_rotation
from geometry.raycast import build_caster

from .axes import new_figure, to_png

_SIDES_DEG = np.arange(0, 360, 45)
_SIDE_NAMES = {0: "ahead", 90: "its left", 180: "behind", 270: "its right"}
_MARGIN_M = 0.06
_FAR_M = 20.0
_WIDTH_IN = 9.0
_DPI = 144
_LIGHT = np.array([0.5, 0.7, 0.5])  # to the viewer's right, towards the viewer, up
_PAPER, _LIT, _DARK = 1.0, 0.8, 0.08  # greys
_N_GREYS = 24  # few: a smaller file


@click.command()
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("results/bodies.png"),
    show_default=True,
    help="PNG file.",
)
def main(out: Path) -> None:
    """Draw every body of the catalogue from eight sides."""
    write_atomically(out, to_png(plot_bodies(load_actors())[0]))


def plot_bodies(actors: Mapping[str, Actor], *, pixels_per_view: int = 144) -> list[Axes]:
    """Bodies from eight sides, one per row, the gait running on along the row.

    A row each: parallel projection, shaded from the right; rows have scales of their own.
    """
    strips = {
        name: np.hstack(
            [
                shade_view(
                    actor.shapes[column % len(actor.shapes)],
                    float(side_deg),
                    size_m=_view_size_m(actor),
                    width_px=pixels_per_view,
                )
                for column, side_deg in enumerate(_SIDES_DEG)
            ]
        )
        for name, actor in actors.items()
    }
    ratios = [strip.shape[0] / strip.shape[1] for strip in strips.values()]
    figure = new_figure(_WIDTH_IN, 0.6 + 1.02 * _WIDTH_IN * sum(ratios), dpi=_DPI)
    panels = figure.subplots(len(strips), 1, squeeze=False, height_ratios=ratios)[:, 0]
    for panel, (name, strip) in zip(panels, strips.items(), strict=True):
        actor = actors[name]
        panel.imshow(strip, cmap="gray", vmin=0.0, vmax=1.0, interpolation="nearest")
        panel.set_ylabel(
            f"{name}\n{actor.length_m:g} x {actor.width_m:g}\nx {actor.height_m:g} m",
            fontsize=8,
            rotation=0,
            ha="right",
            va="center",
        )
        panel.set_yticks([])
        panel.set_xticks([])
        panel.spines[:].set_visible(False)
    panels[0].xaxis.tick_top()
    panels[0].set_xticks(
        (np.arange(len(_SIDES_DEG)) + 0.5) * pixels_per_view,
        [f"{side}° {_SIDE_NAMES.get(side, '')}".strip() for side in _SIDES_DEG.tolist()],
        fontsize=8,
    )
    panels[0].tick_params(length=0)
    return list(panels)


def shade_view(
    shape: Shape, side_deg: float, *, size_m: tuple[float, float], width_px: int
) -> FloatArray:
    """One view in greys, lit from the right and above.

    Shape (height_px, width_px): 0 black, 1 white (also where nothing is). The viewer stands at
    `side_deg`, counter-clockwise from ahead of the body; `size_m` is the view's width and height.
    """
    depth_m = cast_view(shape, side_deg, size_m=size_m, width_px=width_px)
    step_m = size_m[0] / width_px
    is_body = np.isfinite(depth_m)
    filled = np.where(is_body, depth_m, 0.0)
    down, right = np.gradient(filled, step_m)
    normal = np.stack([right, np.ones_like(filled), -down], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    lit = np.clip(normal @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0, 1.0)
    tone = (lit * _N_GREYS).round() / _N_GREYS
    grey: FloatArray = np.where(is_body, _DARK + (_LIT - _DARK) * tone, _PAPER)
    return grey


def cast_view(
    shape: Shape, side_deg: float, *, size_m: tuple[float, float], width_px: int
) -> FloatArray:
    """Depth of a body in parallel projection.

    Shape (height_px, width_px), from a plane far before the body; infinite where nothing is. The
    road is the lower edge, but for a margin. [m]
    """
    step_m = size_m[0] / width_px
    height_px = round(size_m[1] / step_m)
    across = (np.arange(width_px) + 0.5) * step_m - 0.5 * size_m[0]
    up = size_m[1] - _MARGIN_M - (np.arange(height_px) + 0.5) * step_m
    # The viewer looks back at the body: its right is the body's left when it stands ahead.
    towards, right, _ = body_rotation(side_deg).T
    origins = (
        _FAR_M * towards
        + across[None, :, None] * right
        + up[:, None, None] * np.array([0.0, 0.0, 1.0])
    ).reshape(-1, 3)
    vectors = np.broadcast_to(-2.0 * _FAR_M * towards, origins.shape)
    caster = build_caster(shape.vertices_m, shape.triangles)
    share = caster.first_hit(origins.astype(np.float32), vectors.astype(np.float32))
    depth: FloatArray = (2.0 * _FAR_M * share.astype(np.float64)).reshape(height_px, width_px)
    return depth


def _view_size_m(actor: Actor) -> tuple[float, float]:
    """Room for the body from every side: vehicles as seen from the side, walkers wider."""
    across = float(np.hypot(actor.length_m, actor.width_m))
    return across + 2.0 * _MARGIN_M, actor.height_m + 2.0 * _MARGIN_M


if __name__ == "__main__":
    main()
