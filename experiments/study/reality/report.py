"""What recordings measured, in words and tables.

``reality.md``, and the tables fitted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from shapely import Polygon, union_all

from geometry.actors import pick_actor
from geometry.arrays import FloatArray
from geometry.lidar import load_lidar_detection
from placement.detectors.evidence import Interval
from placement.detectors.fitting import (
    ResponseFit,
    fit_lasting_share,
    fit_response,
    share_by_track,
)
from placement.detectors.response import built_in_response

from ...figures.axes import BLUE, GREY, WIDTH_IN, finish_axes, new_figure
from ...perception_lab.fit import draw_intervals, table_text
from ...results.numbers import number, percent
from ...results.tables import page_of
from .places import FalseBraking, PlaceBand, decide_false_tracks, measure_places
from .projection import (
    BODY,
    Heights,
    ViewFlags,
    measure_flags,
    measure_kitti_heights,
    measure_pets_heights,
)
from .response import (
    DISTANCE_EDGES_M,
    HEIGHT_EDGES_PX,
    KITTI_SEQUENCES,
    SHARE_EDGES,
    TABLE_HZ,
    HeldOut,
    Recall,
    Watched,
    confirmed_at_once,
    first_confirmed,
    fit_table,
    hold_out,
    phi,
    recall_of,
    recalls,
    side_errors,
    watch_kitti,
    watch_pets,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


COMMAND = "python -m experiments.study.reality FOLDER"
_LEVELS = ("in view", "partly hidden", "largely hidden")
_SPREAD = (0.1, 0.5, 0.9)
_UNKNOWN = ("contrast", "aspect")


@dataclass(frozen=True)
class Measured:
    """All that is measured, by what was recorded.

    The figures of a recording follow from it.
    """

    heights: Heights
    # Labelled over predicted heights of pedestrians.
    labels: FloatArray
    flags: tuple[ViewFlags, ...]
    pole: Watched
    car: Watched
    # Pedestrians.
    lidar: Watched
    lidar_cyclists: Watched
    # Of PETS' detections.
    places: list[PlaceBand]
    # By what was watched.
    false_braking: Mapping[str, FalseBraking]

    @property
    def watched(self) -> dict[str, Watched]:
        """By the words that the report has for them."""
        return {
            "PETS, camera": self.pole,
            "KITTI, camera": self.car,
            "KITTI, LiDAR": self.lidar,
            "KITTI, LiDAR, cyclists": self.lidar_cyclists,
        }

    @cached_property
    def fits(self) -> dict[str, ResponseFit]:
        """Tables fitted to all frames, by name."""
        return {one.name: fit_table(one) for one in (self.pole, self.car)}

    def probability(self, watched: Watched) -> FloatArray:
        """What the table fitted to a detector predicts of each frame, (n,)."""
        return self.fits[watched.name].detector.probability(
            watched.sightings.evidence()
        )

    @cached_property
    def held(self) -> dict[str, list[HeldOut]]:
        """Halves predicted from the other ones, both ways."""
        return {
            words: [
                hold_out(one, by, fit_first=way)
                for by in one.halves
                for way in (True, False)
            ]
            for words, one in self.watched.items()
        }

    @cached_property
    def by_height(self) -> dict[str, list[Recall]]:
        """Recall by height in the picture."""
        return {
            words: recalls(one, one.sightings.height_px, HEIGHT_EDGES_PX, "px")
            for words, one in self.watched.items()
        }

    @cached_property
    def by_hidden(self) -> dict[str, list[Recall]]:
        """Recall by what is hidden: in per cent, or KITTI's levels."""
        hidden = 100.0 * (1.0 - self.pole.sightings.seen_share)
        edges = [100.0 * edge for edge in SHARE_EDGES]
        found = {"PETS, camera": recalls(self.pole, hidden, edges, "% hidden")}
        for words, one in self.watched.items():
            if one is not self.pole:
                found[words] = [
                    recall_of(one.sightings.take(rows), level)
                    for number, level in enumerate(_LEVELS)
                    if len(rows := np.flatnonzero(one.hidden_level == number))
                ]
        return found

    def panels(self) -> dict[str, Mapping[str, Sequence[Recall]]]:
        """Recalls of the figure: panel by panel, by what was watched."""
        by_level = {words: self.by_hidden[words] for words in list(self.watched)[1:3]}
        return {
            "% hidden": {"PETS, camera": self.by_hidden["PETS, camera"]},
            "hidden": by_level,
            "height, px": {
                words: self.by_height[words] for words in list(self.watched)[:3]
            },
        }

    def confirmations(self) -> dict[str, HeldOut]:
        """Distributions of the figure: people held out."""
        return {
            f"{words}, people held out": next(
                held for held in self.held[words] if held.words.startswith("people")
            )
            for words, one in list(self.watched.items())[:2]
        }


def measure(folder: Path) -> Measured:
    """Read and measure everything below a folder of laid-out repositories.

    Raises InputError if a file is missing, or is not what its format asks for.
    """
    pole = watch_pets(folder)
    return Measured(
        heights=measure_pets_heights(folder),
        labels=measure_kitti_heights(folder, KITTI_SEQUENCES),
        flags=measure_flags(folder),
        pole=pole,
        car=watch_kitti(folder, name="car-2019", class_name="pedestrian"),
        lidar=watch_kitti(folder, name="pointrcnn-2019", class_name="pedestrian"),
        lidar_cyclists=watch_kitti(folder, name="pointrcnn-2019", class_name="cyclist"),
        places=measure_places(folder, pole),
        false_braking={
            "KITTI, camera": decide_false_tracks(folder, "car-2019", "pedestrian"),
            "KITTI, LiDAR": decide_false_tracks(folder, "pointrcnn-2019", "pedestrian"),
            "KITTI, LiDAR, cyclists": decide_false_tracks(
                folder, "pointrcnn-2019", "cyclist"
            ),
        },
    )


def _share(interval: Interval) -> str:
    """A share with its interval, in per cent."""
    low, high = (f"{100.0 * one:.0f}" for one in (interval.low, interval.high))
    return f"{percent(interval.value)} ({low} to {high})"


def _plain(interval: Interval) -> str:
    return (
        f"{number(interval.value)} ({number(interval.low)} to {number(interval.high)})"
    )


def comparisons(m: Measured) -> list[tuple[str, Interval, float]]:
    """Headline figures: what, as measured with its interval, as predicted."""
    table = built_in_response()
    rows = [("tilt of PETS' camera that fits best, degrees", m.heights.tilt_deg, 0.0)]
    for words, one in m.watched.items():
        groups = [recall_of(one.sightings, "recall")]
        if one in (m.pole, m.car):
            groups += [*m.by_hidden[words], confirmed_at_once(one)]
        rows += [(f"{words}: {g.words}", g.measured, g.predicted) for g in groups]
    for one in (m.pole, m.car):
        fitted = m.fits[one.name].intervals
        for key, words in (
            ("frame_correlation", "correlation of what decides consecutive frames"),
            ("box_noise_share", "error of boxes' sides, as a share"),
        ):
            rows.append((f"{one.name}: {words}", fitted[key], getattr(table, key)))
    return rows


def text(m: Measured) -> str:
    """The report, as Markdown."""
    in_16 = m.car.halves["sequence"]
    height_px = m.car.sightings.height_px
    rows = (m.lidar.hidden_level == 0) & (m.lidar.distance_m < lidar_reach_m())
    seen = m.lidar.sightings
    compared = comparisons(m)
    fitted = {words: one for words, one in m.watched.items() if one.name in m.fits}
    return page_of(
        files(__package__) / "reality.md.j2",
        m=m,
        command=COMMAND,
        n_compared=len(compared),
        off=[
            f"{what} {_plain(measured)}, not {number(predicted)}"
            for what, measured, predicted in compared
            if not measured.low <= predicted <= measured.high
        ],
        percent=percent,
        plain=_plain,
        share=_share,
        phi=phi,
        in_16=float(in_16.mean()),
        least_px=height_px[in_16].min(),
        small=float((height_px < height_px[in_16].min())[~in_16].mean()),
        held_out=_held_out_rows(m),
        limit=_LIMIT,
        missed=[
            f"{words}, {one.words} {one.error:.3f}"
            for words, halves in m.held.items()
            for one in halves
            if one.error >= _LIMIT
        ],
        fewest=min(one.tracks for halves in m.held.values() for one in halves),
        most=max(one.tracks for halves in m.held.values() for one in halves),
        correlations=[
            f"{words}: phi {phi(one.sightings).value:.2f} at {one.frame_rate_hz:g} Hz,"
            " frame_correlation"
            f" {_plain(m.fits[one.name].intervals['frame_correlation'])}"
            for words, one in fitted.items()
        ],
        lasting=[
            f"{words}: {_plain(fit_lasting_share(one.sightings, m.probability(one)))}"
            for words, one in fitted.items()
        ],
        n_people=len(np.unique(m.heights.track)),
        height_m=pick_actor(BODY, "body").height_m,
        ratios=_ratio_rows(m.heights),
        labels=np.quantile(m.labels, _SPREAD),
        agreed=float(np.mean([flag.agreed for flag in m.flags])),
        flags=[
            [
                f.view,
                str(f.people),
                *map(percent, (f.in_view, f.agreed, f.agreed_pinhole)),
            ]
            for f in m.flags
        ],
        found=[
            (
                one,
                words,
                side_errors(one.sightings),
                first_confirmed(one.sightings),
                rows,
            )
            for words, one in m.watched.items()
            for rows in [_recall_rows(m, words, one)]
        ],
        places=_place_rows(m.places),
        false_braking=[
            [words, str(one.tracks), str(one.braked), _share(one.share)]
            for words, one in m.false_braking.items()
        ],
        all_tracks=sum(one.tracks for one in m.false_braking.values()),
        all_braked=sum(one.braked for one in m.false_braking.values()),
        reach_m=lidar_reach_m(),
        in_reach=share_by_track(seen.is_found[rows], seen.track[rows]),
    )


# Of calibration errors, as asked for.
_LIMIT = 0.05


def _held_out_rows(m: Measured) -> list[list[str]]:
    return [
        [
            *(words, one.words, f"{one.frames} of {one.tracks}"),
            *(f"{one.error:.3f} ({one.chance_error:.3f})", f"{one.distance:.3f}"),
            f"{np.abs(one.real - one.by_response).max():.3f}",
        ]
        for words, halves in m.held.items()
        for one in halves
    ]


def _place_rows(bands: Sequence[PlaceBand]) -> list[list[str]]:
    """By distance: measured errors, and how many times that is predicted."""
    rows = []
    for one in bands:
        along = one.predicted_along_m / one.along_m
        across = one.predicted_across_m / one.across_m
        figures = [one.along_m, along, one.across_m, across]
        rows.append([one.words, str(one.n), *map(number, figures)])
    return rows


def _ratio_rows(h: Heights) -> list[list[str]]:
    rows = []
    ratios = {"lens as calibrated": h.ratio, "pinhole of this project": h.pinhole_ratio}
    for name, ratio in ratios.items():
        near = ratio[h.distance_m < 20.0]
        far = ratio[h.distance_m >= 30.0]
        figures = [*np.quantile(ratio, _SPREAD), np.median(near), np.median(far)]
        rows.append([name, *(number(float(value), 3) for value in figures)])
    return rows


def _recall_rows(m: Measured, words: str, one: Watched) -> list[list[str]]:
    distance = recalls(one, one.distance_m, DISTANCE_EDGES_M, "m")
    groups = [
        recall_of(one.sightings, "all"),
        *m.by_hidden[words],
        *m.by_height[words],
        *distance,
    ]
    return [
        [g.words, str(g.frames), str(g.tracks), _share(g.measured)]
        + [percent(g.predicted), "*" if g.is_off else ""]
        for g in groups
    ]


# KITTI's LiDAR, Velodyne HDL-64E: A. Geiger et al., "Vision meets robotics", 2013,
# sensor setup.
_HDL_LINES = 64
_HDL_FOV_DEG = 26.8
_HDL_POINTS_PER_S = 1.3e6


@cache
def lidar_reach_m() -> float:
    """Distance up to which KITTI's LiDAR returns enough points.

    As many as this project's rule asks for.

    If every pulse comes back: outline of the body from ahead and from the side, times
    pulses per solid angle. [m]
    """
    shape = pick_actor(BODY, "body").shapes[0]
    areas = []
    for axis in (0, 1):
        corners = shape.vertices_m[shape.triangles][:, :, [axis, 2]]
        areas.append(union_all([Polygon(one).buffer(1.0e-6) for one in corners]).area)
    columns = _HDL_POINTS_PER_S / TABLE_HZ / _HDL_LINES
    per_sr = columns / (2.0 * np.pi) * _HDL_LINES / np.radians(_HDL_FOV_DEG)
    n_points = load_lidar_detection().min_points["pedestrian"]
    return float(np.sqrt(np.mean(areas) * per_sr / n_points))


def tables(m: Measured) -> dict[str, str]:
    """Response tables of cameras, and the LiDAR's recalls, as TOML.

    By the names of their files.
    """
    written = {}
    for one in (m.pole, m.car):
        head = f"{one.detector}, {one.year}, on {one.recording} ({one.source}), "
        written[f"{one.name}.toml"] = table_text(
            m.fits[one.name],
            source=f"{head}{one.frame_rate_hz:g} Hz",
            command=COMMAND,
            unknown=_UNKNOWN,
            false_tracks_per_hour=one.alarms.per_hour,
        )
    classes = []
    for name, one in (("pedestrian", m.lidar), ("cyclist", m.lidar_cyclists)):
        groups = recalls(one, one.distance_m, DISTANCE_EDGES_M, "m")
        shares = [_three(group.measured) for group in groups]
        link = fit_response(one.sightings, name=name).intervals["frame_correlation"]
        classes.append((name, one, groups, [*zip(*shares, strict=True)], _three(link)))
    lidar = files(__package__) / "lidar.toml.j2"
    written["pointrcnn-2019.toml"] = page_of(
        lidar, one=m.lidar, command=COMMAND, classes=classes, phi=phi, three=_three
    )
    return written


def _three(figure: Interval) -> list[float]:
    return [float(f"{value:.3g}") for value in (figure.value, figure.low, figure.high)]


# Of the distance.
_BAND_M = 2.0
# Boxes in a band.
_LEAST = 30
_MAX_FRAMES = 30
_SMALL = 7.5
_STYLES = {
    "PETS, camera": ("o", BLUE),
    "KITTI, camera": ("^", "black"),
    "KITTI, LiDAR": ("v", "#777777"),
}


def plot_heights(heights: Heights) -> "Figure":
    """Drawn over predicted heights by distance: medians, and the middle 80 %."""
    figure = new_figure(WIDTH_IN, 2.8)
    axes = figure.add_subplot()
    bands = np.floor(heights.distance_m / _BAND_M)
    places = []
    rows = []
    for band in np.unique(bands).tolist():
        mask = bands == band
        if mask.sum() >= _LEAST:
            places.append((band + 0.5) * _BAND_M)
            spread = np.quantile(heights.ratio[mask], [0.1, 0.5, 0.9])
            rows.append([*spread, np.median(heights.pinhole_ratio[mask])])
    low, middle, high, pinhole = np.array(rows).T
    axes.axhline(1.0, color=GREY, linewidth=1.0)
    axes.fill_between(places, low, high, color="#dddddd", label="10 to 90 %")
    axes.plot(
        places, middle, "o-", color=BLUE, markersize=4, label="median, calibrated lens"
    )
    axes.plot(
        places, pinhole, "s--", color="black", mfc="none", ms=5, label="median, pinhole"
    )
    axes.set_ylim(0.8, 1.2)
    axes.legend(fontsize=_SMALL, frameon=False, ncol=3, loc="upper right")
    finish_axes(
        axes, x="distance on the ground, m", y="drawn / predicted height", grid="y"
    )
    return figure


def plot_recall(panels: Mapping[str, Mapping[str, Sequence[Recall]]]) -> "Figure":
    """Recall with 95 % intervals, and what "response" predicts.

    Panel by panel.

    A panel has groups by what was watched.
    """
    figure = new_figure(WIDTH_IN, 3.3)
    handles: dict[str, Any] = {}
    for axes, (title, watched) in zip(
        figure.subplots(1, len(panels)), panels.items(), strict=True
    ):
        # In order.
        names = [one.words for one in max(watched.values(), key=len)]
        names += [one.words for groups in watched.values() for one in groups]
        names = list(dict.fromkeys(names))
        for place, (name, groups) in enumerate(watched.items()):
            shift = 0.24 * (place - 0.5 * (len(watched) - 1))
            places = np.array([names.index(one.words) + shift for one in groups])
            marker, colour = _STYLES[name]
            look = {
                "fmt": marker,
                "color": colour,
                "ms": 4,
                "capsize": 2,
                "linewidth": 1.0,
            }
            handles[name] = draw_intervals(
                axes, places, [one.measured for one in groups], **look
            )
            predicted = [one.predicted for one in groups]
            (handles["table `response`"],) = axes.plot(
                places, predicted, "_k", ms=7, mew=2.0
            )
        axes.set_xticks(
            range(len(names)), [_short(name) for name in names], rotation=40
        )
        axes.set_title(title, fontsize=8)
        axes.set_ylim(0.0, 1.04)
        finish_axes(axes, y="share found" if axes is figure.axes[0] else None, grid="y")
    below: dict[str, Any] = {"loc": "outside lower center", "ncol": 4, "frameon": False}
    figure.legend(handles.values(), handles.keys(), fontsize=_SMALL, **below)
    return figure


def _short(words: str) -> str:
    words = words.replace(" to ", "-").replace(" and more", "+")
    return words.replace(" hidden", "").replace(" px", "").replace(" %", "")


def plot_confirmations(held: Mapping[str, HeldOut]) -> "Figure":
    """Share of starts confirmed within so many frames.

    Real, by the fit, by "response".
    """
    figure = new_figure(WIDTH_IN, 2.8)
    for axes, (title, one) in zip(
        figure.subplots(1, len(held)), held.items(), strict=True
    ):
        frames = np.arange(1, _MAX_FRAMES + 1)
        for values, style, width, words in (
            (one.real, "-", 2.0, "real"),
            (one.predicted, "--", 1.5, "fitted to the other half"),
            (one.by_response, ":", 1.5, "response"),
        ):
            look = {"color": BLUE if words == "real" else "black", "linewidth": width}
            axes.step(
                frames, values[:_MAX_FRAMES], style, where="post", label=words, **look
            )
        axes.set_ylim(0.4, 1.0)
        axes.set_xlim(2, _MAX_FRAMES)
        axes.set_title(title, fontsize=8)
        axes.legend(fontsize=_SMALL, frameon=False, loc="lower right")
        finish_axes(axes, x="frames", y="share of starts confirmed", grid="both")
    return figure
