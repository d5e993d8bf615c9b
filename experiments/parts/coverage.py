"""The ground by pixel density: a map, and the shares in words."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch

from geometry.junction import COMPASS
from geometry.scene import Scene
from placement.ground import BANDS, GroundCoverage, find_ground_coverage
from placement.layout import Layout

from ..figures.axes import WIDTH_IN, finish_axes, new_axes
from ..figures.plan import CLASS_STYLES, draw_scene
from ..results.numbers import NOTHING, percent
from .section import Section, Table, build_picture

# One hue from light to dark: in greyscale the order stays.
_SHADES = ("#ffffff", "#f1eef6", "#d0d1e6", "#a6bddb", "#67a9cf", "#3690c0", "#016c59", "#014636")


def plot_coverage(coverage: GroundCoverage, scene: Scene, layout: Layout) -> Axes:
    """Map of the ground around a junction, darker where cameras see it more finely; north up."""
    axes = new_axes(WIDTH_IN, WIDTH_IN - 1.8)
    draw_scene(axes, scene)
    edges = [0.0, 1.0e-9, *(least for _, least in reversed(BANDS)), 1.0e9]
    half = 0.5 * (coverage.east_m[1] - coverage.east_m[0])
    extent = (
        coverage.east_m[0] - half,
        coverage.east_m[-1] + half,
        coverage.north_m[0] - half,
        coverage.north_m[-1] + half,
    )
    axes.imshow(
        np.ma.masked_where(~coverage.is_road, coverage.density),
        origin="lower",
        extent=extent,
        cmap=ListedColormap(list(_SHADES)),
        norm=BoundaryNorm(edges, len(_SHADES)),
        interpolation="nearest",
        zorder=4,
    )
    unseen = coverage.is_road & (coverage.density == 0.0)
    axes.contourf(
        coverage.east_m,
        coverage.north_m,
        unseen.astype(float),
        levels=[0.5, 1.5],
        colors="none",
        hatches=["xxx"],
        zorder=5,
    )
    for unit in layout.units:
        axes.plot(*unit.pose.position_m[:2], marker="^", color="black", markersize=8, zorder=9)
    axes.set_xlim(extent[0], extent[1])
    axes.set_ylim(extent[2], extent[3])
    axes.set_aspect("equal")
    finish_axes(axes, x="east (m); north is up", size=9, hidden=())
    names = ["unseen", "coarser", *(name for name, _ in reversed(BANDS))]
    lows = ["", "", *(f", from {least:g} px/m" for _, least in reversed(BANDS))]
    axes.legend(
        handles=[
            Patch(
                facecolor=shade,
                edgecolor="#777777",
                hatch="xxx" if name == "unseen" else None,
                label=f"{name}{low}",
            )
            for name, low, shade in zip(names, lows, _SHADES, strict=True)
        ]
        + [Patch(**CLASS_STYLES["building"], label="building")],
        fontsize=7,
        loc="upper left",
        bbox_to_anchor=(1.01, 1.0),
    )
    return axes


def coverage_section(scene: Scene, layout: Layout) -> Section:
    """Roads as the cameras see them: a sentence, a table, a map."""
    coverage = find_ground_coverage(scene, layout.units)
    sentence, rows = coverage_sentence(coverage), coverage_rows(coverage.shares())
    table = Table(
        caption="Share of the road within 45 m, by what its pixels would allow in surveillance",
        columns=["band", "at least", "share"],
        rows=rows,
        numeric=range(1, 3),
    )
    picture = build_picture(
        plot_coverage(coverage, scene, layout),
        title="Pixel density on the road",
        caption="Of the camera that sees a place most finely, one metre above the road; "
        "nothing parks or drives. Bands of EN IEC 62676-4. Triangles: cameras.",
        alt=f"Map of the roads by pixel density. {sentence} "
        + "; ".join(f"{name}: {share}" for name, _, share in rows)
        + ".",
    )
    note = (
        f"{sentence} How finely a place is seen does not decide who is saved: the detections above "
        "do."
    )
    return Section("road", "What the cameras see of the road", [note, table, picture])


def coverage_rows(shares: Mapping[str, float]) -> list[list[str]]:
    """A row per band that has any ground: name, least density, share of the road."""
    least = dict(BANDS)
    return [
        [name, f"{least[name]:g} px/m" if name in least else NOTHING, percent(share)]
        for name, share in shares.items()
        if share > 0.0
    ]


def coverage_sentence(coverage: GroundCoverage) -> str:
    """Sentence on the seen share of the road, and its largest blind spot."""
    shares = coverage.shares()
    text = f"{percent(1.0 - shares['unseen'])} of the road within 45 m is seen by a camera"
    spot = _largest_blind_spot(coverage)
    if spot is None:
        return f"{text}."
    size_m2, where = spot
    return f"{text}; the largest blind spot has {size_m2:.0f} m\N{SUPERSCRIPT TWO}, {where}."


def _largest_blind_spot(coverage: GroundCoverage) -> tuple[float, str] | None:
    from scipy.ndimage import label

    unseen = coverage.is_road & (coverage.density == 0.0)
    regions, n_regions = label(unseen)
    if n_regions == 0:
        return None
    sizes = np.bincount(regions.ravel())[1:]
    rows, columns = np.nonzero(regions == 1 + int(np.argmax(sizes)))
    middle = np.array([coverage.east_m.mean(), coverage.north_m.mean()])
    spot = np.array([coverage.east_m[columns].mean(), coverage.north_m[rows].mean()]) - middle
    point = COMPASS[round(float(np.degrees(np.arctan2(spot[1], spot[0]))) / 45.0) % 8]
    return float(sizes.max()), f"{np.hypot(*spot):.0f} m to the {point} of the junction's middle"
