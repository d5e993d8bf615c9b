"""The ground by pixel density: a map, and the shares in words."""

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch

from geometry.junction import COMPASS
from geometry.scene import Scene
from placement.candidates import CandidatePose
from placement.ground import (
    BANDS,
    GroundCoverage,
    PrivateGround,
    find_ground_coverage,
    private_shares,
)
from placement.layout import Layout

from ..figures.axes import WIDTH_IN, finish_axes, new_axes
from ..figures.plan import CLASS_STYLES, draw_scene
from ..results.numbers import NOTHING, percent
from ..results.record import Record, Share, says
from .section import Block, Section, Table, build_picture

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


# ---------- private ground


class PrivateAreaRecord(Record, frozen=True, kw_only=True):
    """An area."""

    name: Annotated[str, says("Name in the file.")]
    area_m2: Annotated[float, says("Size, in square metres.", ge=0)]


class PrivateGroundRecord(Record, frozen=True, kw_only=True):
    """Views of cameras into areas that they must not look into."""

    areas: Annotated[tuple[PrivateAreaRecord, ...], says("The areas.")]
    units: Annotated[dict[str, dict[str, Share]], says("Of each unit, by its id.")]


def build_private_ground_record(
    units: Sequence[CandidatePose], scene: Scene, ground: PrivateGround
) -> PrivateGroundRecord:
    """Shares of private ground that units see."""
    shares = private_shares(scene, units, ground)
    return PrivateGroundRecord(
        areas=tuple(
            PrivateAreaRecord(name=name, area_m2=float(area))
            for name, area in zip(ground.names, ground.area_m2, strict=True)
        ),
        units={
            unit.id: dict(zip(ground.names, row.tolist(), strict=True))
            for unit, row in zip(units, shares, strict=True)
        },
    )


def private_ground_sentence(found: PrivateGroundRecord) -> str:
    """Which unit sees how much of which area."""
    seen = [
        f"{unit} sees {percent(share)} of {name}"
        for unit, shares in found.units.items()
        for name, share in shares.items()
        if share > 0.0
    ]
    n_areas = len(found.areas)
    what = "the private area" if n_areas == 1 else f"any of the {n_areas} private areas"
    if not seen:
        return f"No camera has {what} in its picture."
    return f"Of private ground, {'; '.join(seen)}."


def private_ground_sentences(
    found: PrivateGroundRecord | None, others: Mapping[str, PrivateGroundRecord | None]
) -> list[str]:
    """The same of a result; `others` are those of layouts compared with it, by name."""
    if found is None:
        return []
    return [
        private_ground_sentence(found),
        *(f"{name}: {private_ground_sentence(other)}" for name, other in others.items() if other),
    ]


# ---------- the section of the report


MAX_UNITS, MAX_AREAS = 12, 60
"""Columns and rows of the table: beyond, only what is seen the most."""
_MAX_NAMED = 6  # pairs of unit and area in a sentence


def private_ground_section(
    found: PrivateGroundRecord | None, labels: Mapping[str, str]
) -> Section | None:
    """Shares of private ground that units see, the most seen areas first; None without any.

    `labels` are short names of the units, by id.
    """
    if not found:
        return None
    units, areas = found.units, found.areas
    most_seen = {
        area.name: max((shares[area.name] for shares in units.values()), default=0.0)
        for area in areas
    }
    seeing = sorted(units, key=lambda unit_id: -max(units[unit_id].values(), default=0.0))
    shown = [unit_id for unit_id in units if unit_id in set(seeing[:MAX_UNITS])]
    rows = sorted(areas, key=lambda area: -most_seen[area.name])[:MAX_AREAS]
    caption = "Share of each private area that a unit sees"
    for n_shown, n_all, what in (
        (len(shown), len(units), "units"),
        (len(rows), len(areas), "areas"),
    ):
        if n_shown < n_all:
            caption += f"; of {n_all} {what} the {n_shown} that matter most"
    table = Table(
        caption=caption,
        columns=[
            "area",
            "size (m\N{SUPERSCRIPT TWO})",
            "most, by one unit",
            *(labels.get(unit_id, unit_id) for unit_id in shown),
        ],
        rows=[
            [
                area.name,
                f"{area.area_m2:.0f}",
                percent(most_seen[area.name]),
                *(percent(units[unit_id][area.name]) for unit_id in shown),
            ]
            for area in rows
        ],
        numeric=range(1, 3 + len(shown)),
    )
    note = (
        "Seen is what lies in a camera's picture with nothing in between, at the height of "
        "people's eyes. LiDARs take no pictures."
    )
    blocks: list[Block] = [_short_sentence(found, most_seen), table, note]
    return Section("private-ground", "Private ground", blocks)


def _short_sentence(found: PrivateGroundRecord, most_seen: Mapping[str, float]) -> str:
    """Who sees what, where few do; where many do, only how many."""
    n_seen = sum(share > 0.0 for share in most_seen.values())
    n_seeing = sum(max(shares.values()) > 0.0 for shares in found.units.values())
    if n_seen * n_seeing <= _MAX_NAMED:
        return private_ground_sentence(found)
    worst = max(most_seen, key=lambda name: most_seen[name])
    return (
        f"{n_seeing} of {len(found.units)} units see something of {n_seen} of "
        f"{len(most_seen)} private areas; the most is {percent(most_seen[worst])} of {worst}."
    )
