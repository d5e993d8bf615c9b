"""The CarlaNCAP study's figures and ours.

``python -m experiments.study.reproduction``.

Ours are those of its own setting, and of variants of it: one thing of ours, or that the
study leaves open, is changed.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import click
import msgspec
import numpy as np

from geometry.actors import PlacedActor, pick_actor
from geometry.catalogue import pick_camera
from geometry.errors import InputError
from geometry.poses import Pose, body_rotation
from geometry.scene import Scene
from geometry.study_scene import load_study_scene
from geometry.text_formats import load_data
from geometry.writing import write_atomically
from placement.compute import Compute, silent
from placement.detectors import load_planning_detector
from placement.detectors.geometric import GeometricDetector
from placement.evaluation import Evaluation, apr, detected_share
from placement.evaluator import evaluate_layout
from placement.layout import Layout, load_carlancap_layout
from placement.question import Question
from placement.setting import Setting, build_setting
from scenarios.aeb import load_track_memory_s
from scenarios.cases import Case, select_cases
from scenarios.positions import AT_ZERO, Position, is_bound, read_position
from scenarios.runs import Run, build_frame_axis, build_runs
from scenarios.weights import weight_per_run

from ..figures.axes import to_png
from ..figures.evaluation import plot_heatmaps
from ..language import mark
from ..progress import StageProgress
from ..results.numbers import percent
from ..results.tables import page_of

# ---------- variants of the setting
OWN_CASES = "CPNC-50,CBNA,CBLA"
"""The cases whose starts and figures the study publishes."""
# At the junction alone, every run alike, a track for ever once confirmed.
AS_STUDIED = Question(
    cases=OWN_CASES, along_arms="0", weights="run", track_memory_s=math.inf
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StudyVariant:
    """A setting and the study's layout in it.

    Attributes
    ----------
    name : str
        What is changed.
    setting : Setting
        Scene, runs, detector.
    layout : Layout
        The study's 12 cameras.
    """

    name: str
    setting: Setting
    layout: Layout


def build_variants() -> tuple[StudyVariant, ...]:
    """Variants of the reconstruction, the first one as it is.

    Then changed walls, parked cars, smallest boxes and fields of view.
    """
    base = build_setting(AS_STUDIED, load_study_scene())
    open_corner = move_walls(base.scene, -5.0)
    settings = {
        "as it is": base,
        "walls 0.5 m nearer to the corner": replace(
            base, scene=move_walls(base.scene, 0.5)
        ),
        "walls 5 m farther from the corner": replace(base, scene=open_corner),
        "no parked cars": _keep_parked(base, 0),
        "no parked cars, walls 5 m farther": replace(
            _keep_parked(base, 0), scene=open_corner
        ),
        "two parked cars instead of eight": _keep_parked(base, 2),
        "parked row 1 m beside the VUT, not 0.5 m": _move_parked(base, 0.5),
        "smallest box 30 px": _detect_from(base, 30.0),
        "smallest box 50 px": _detect_from(base, 50.0),
    }
    return _with_narrow(settings, {_NARROW: base})


_NARROW = "field of view 90 deg, not 110"


def _with_narrow(
    settings: Mapping[str, Setting], narrow: Mapping[str, Setting]
) -> tuple[StudyVariant, ...]:
    """Variants with the study's cameras.

    Then those in which they all look less wide.

    Theirs is the field of view of the study's text, on the VUT, too.
    """
    layout = load_carlancap_layout()
    camera = pick_camera("carla-ncap-rgb-90", "variants")
    units = tuple(replace(unit, sensor=camera) for unit in layout.units)
    less_wide = replace(layout, units=units)
    return (
        *(
            StudyVariant(name=name, setting=one, layout=layout)
            for name, one in settings.items()
        ),
        *(
            StudyVariant(
                name=name, setting=replace(one, vut_camera=camera), layout=less_wide
            )
            for name, one in narrow.items()
        ),
    )


def move_walls(scene: Scene, by_m: float) -> Scene:
    """Every wall moved towards the middle of a junction.

    By metres along both roads.
    """
    vertices = scene.vertices_m.copy()
    middle = scene.outline_m.mean(axis=0)
    for index, instance in enumerate(scene.instances):
        if instance.class_name == "wall":
            own = np.unique(scene.triangles[scene.triangle_instance == index])
            nearest = own[np.argmin(np.linalg.norm(vertices[own, :2] - middle, axis=1))]
            vertices[own, :2] -= by_m * np.sign(vertices[nearest, :2] - middle)
    return replace(scene, vertices_m=vertices)


def _keep_parked(setting: Setting, count: int) -> Setting:
    runs = tuple(
        replace(run, obstruction=run.obstruction[:count]) for run in setting.runs
    )
    return replace(setting, runs=runs)


def _move_parked(setting: Setting, by_m: float) -> Setting:
    """Parked bodies moved away from the VUT's path, to its right. [m]."""
    runs = []
    for run in setting.runs:
        right = -body_rotation(float(run.vut_yaw_deg[0]))[:, 1]
        bodies = []
        for parked in run.obstruction:
            position_m = parked.pose.position_m + by_m * right
            pose = Pose(position_m=position_m, yaw_deg=parked.pose.yaw_deg)
            bodies.append(PlacedActor(actor=parked.actor, pose=pose))
        runs.append(replace(run, obstruction=tuple(bodies)))
    return replace(setting, runs=tuple(runs))


def _detect_from(setting: Setting, height_px: float) -> Setting:
    default = load_planning_detector()
    assert isinstance(default, GeometricDetector)
    detector = replace(default, min_box_height_px=height_px)
    return replace(setting, detector=detector, table_detector=detector)


ADDITIONAL_CASES = ("CPNCO-50", "CPLA-50", "CBTAno-50", "CBTAfo-50")
TURNING = ("CBTAno-50", "CBTAfo-50")
LARGE_BOX = "smallest box 60 px"
BEFORE = "15 m before the crosswalk"
BEHIND = "cyclist comes from behind"
BEHIND_NARROW = "cyclist comes from behind, field of view 90 deg"
FARTHEST = "met 30 m farther out on the exit arm, no buildings"
SHORTEST = "recordings of the last 0.6 s before the impact"


def build_additional_variants() -> tuple[StudyVariant, ...]:
    """As it is first; some are about some of the cases only."""
    scene = load_study_scene()
    cases = {
        case.name: case
        for case in select_cases("study").cases
        if case.name in ADDITIONAL_CASES
    }
    turning = [cases[name] for name in TURNING]
    some = build_setting(replace(AS_STUDIED, cases=TURNING[0]), scene)
    base = _lay(some, cases.values())
    along = [case for case in cases.values() if not is_bound(case)]
    live = replace(base, rule=replace(base.rule, track_memory_s=load_track_memory_s()))
    open_scene = _without(scene, ("building", "wall", "vegetation"))
    behind = _lay(base, [replace(case, vru_direction="same") for case in turning])
    settings = {
        "as it is": base,
        f"a track lives for {live.rule.track_memory_s:g} s": live,
        LARGE_BOX: _detect_from(base, 60.0),
        **{
            f"recordings of the last {last_s:g} s before the impact": _shorten(
                base, last_s
            )
            for last_s in (5.0, 3.0, 1.0, 0.6)
        },
        **{
            f"{place_m} m before the crosswalk": _lay(
                base, along, position=read_position(f"-{place_m}", "variants")
            )
            for place_m in (15, 30)
        },
        "cyclist at 20 km/h": _lay(
            base, [replace(case, vru_speed_kmh=20.0) for case in turning]
        ),
        **{
            f"met at {percent:g} % of the VUT's width": _lay(
                base, [replace(case, impact_percent=percent) for case in turning]
            )
            for percent in (25.0, 75.0)
        },
        **{
            f"met {away_m:g} m farther out on the exit arm, no buildings": _lay(
                replace(base, scene=open_scene),
                [_farther(case, away_m) for case in turning],
            )
            for away_m in (15.0, 30.0)
        },
        BEHIND: behind,
    }
    return _with_narrow(settings, {_NARROW: base, BEHIND_NARROW: behind})


def _lay(
    setting: Setting, cases: Iterable[Case], *, position: Position = AT_ZERO
) -> Setting:
    """A setting with other cases at all of their speeds, each run alike."""
    runs, _ = build_runs(
        setting.scene,
        cases,
        vut=pick_actor("vut", "variants"),
        rule=setting.rule,
        positions=(position,),
        is_spread=False,
    )
    return _of_runs(setting, runs)


def _farther(case: Case, away_m: float) -> Case:
    """A turning case whose VRU crosses farther from the junction, by metres."""
    assert case.vru_line is not None
    left_m = case.vru_line.left_m + away_m
    return replace(case, vru_line=replace(case.vru_line, outside_kerb_m=left_m))


def _without(scene: Scene, classes: Sequence[str]) -> Scene:
    """A scene without the things of some classes."""
    kept = [
        i for i, thing in enumerate(scene.instances) if thing.class_name not in classes
    ]
    number = np.full(len(scene.instances), -1, dtype=scene.triangle_instance.dtype)
    number[kept] = np.arange(len(kept))
    stays = number[scene.triangle_instance] >= 0
    return replace(
        scene,
        triangles=scene.triangles[stays],
        triangle_instance=number[scene.triangle_instance[stays]],
        instances=tuple(scene.instances[i] for i in kept),
    )


def _shorten(setting: Setting, last_s: float) -> Setting:
    """Recordings that begin so long before the impact, if they began earlier.

    [s].
    """
    names = ("time_s", "vut_position_m", "vut_yaw_deg", "vru_position_m", "vru_yaw_deg")
    runs = []
    for run in setting.runs:
        kept = run.time_s >= -last_s - _TOLERANCE_S
        frames = {name: getattr(run, name)[kept] for name in (*names, "vru_shape")}
        runs.append(replace(run, **frames))
    return _of_runs(setting, runs)


_TOLERANCE_S = 1.0e-6


def _of_runs(setting: Setting, runs: Sequence[Run]) -> Setting:
    axis = build_frame_axis(runs, weight_per_run(runs))
    return replace(setting, runs=tuple(runs), axis=axis)


# ---------- the study's figures beside ours
CASES = tuple(OWN_CASES.split(","))
# The runs that the study draws.
HEATMAP_SPEEDS_KMH = {
    "CPNC-50": 55,
    "CBNA": 60,
    "CBLA": 50,
}
WEATHERS = ("day", "night", "rain", "fog")
DETECTORS = ("geometric", "response")
_NEARLY_ALL = 0.9


class PublishedFigure(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A figure of the study.

    Attributes
    ----------
    quantity, case : str
        What, as :func:`quantities` names it, and in which case.
    value : float
        Share of 1.
    use : str
        "set by it" or "compared".
    depends_on : str
        What of ours it hangs on most.
    """

    quantity: str
    case: str
    value: float
    use: Literal["set by it", "compared"]
    depends_on: str


class AdditionalFigure(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A figure of the study's additional cases, another recording.

    Nothing was fitted to it.

    Attributes
    ----------
    quantity, case : str
        What, as :func:`quantities` names it, and in which case.
    published : str
        What the study says, in words.
    """

    quantity: str
    case: str
    published: str


class Published(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All figures of the study."""

    figures: tuple[PublishedFigure, ...]
    additional: tuple[AdditionalFigure, ...]


@cache
def load_published() -> Published:
    """The study's figures, from ``data/carla_ncap_published.toml``."""
    table = load_data("experiments", "carla_ncap_published.toml")
    return msgspec.convert(table, Published)


def quantities(evaluation: Evaluation) -> dict[tuple[str, str], float]:
    """Figures that the study publishes or leaves open.

    As shares of 1, by quantity and case.
    """
    axis = evaluation.axis
    parties = {
        "the VUT": evaluation.vut,
        "any RSU": evaluation.rsu_all,
        **evaluation.units,
    }
    found = {}
    for case in dict.fromkeys(axis.cases):
        mask = np.array(axis.cases) == case
        for name, verdict in parties.items():
            found[f"APR of {name}", case] = apr(verdict, axis, mask)
            found[f"frames of {name}", case] = detected_share(verdict, axis, mask)
        alone = [found[f"APR of {name}", case] for name in evaluation.units]
        found["APR of the best RSU", case] = max(alone)
    return found


def write_reproduction(folder: Path, *, compute: Compute) -> None:
    """Evaluate all variants and weathers, and write ``reproduction.md``."""
    variants = build_variants()
    additional = build_additional_variants()
    in_weathers = []
    for detector in DETECTORS:
        question = replace(AS_STUDIED, weather=",".join(WEATHERS), detector=detector)
        setting = build_setting(question, variants[0].setting.scene)
        in_weathers.append(replace(variants[0], setting=setting))
    every = [*variants, *in_weathers, *additional]
    quiet = replace(compute, progress=silent)
    all_found = []
    for n_done, variant in enumerate(every):
        compute.progress(mark("evaluate variants"), n_done, len(every))
        all_found.append(
            evaluate_layout(variant.layout, variant.setting, compute=quiet)
        )
    n_weathers = len(variants) + len(DETECTORS)
    evaluations = all_found[: len(variants)]
    by_weather = dict(
        zip(DETECTORS, all_found[len(variants) : n_weathers], strict=True)
    )
    of_additional = {
        variant.name: quantities(evaluation)
        for variant, evaluation in zip(additional, all_found[n_weathers:], strict=True)
    }
    base = evaluations[0]
    heatmaps = [
        base.axis.run_ids.index(f"{case}/east/{speed}")
        for case, speed in HEATMAP_SPEEDS_KMH.items()
    ]
    picture = to_png(plot_heatmaps(base, heatmaps)[0])
    found = [quantities(evaluation) for evaluation in evaluations]
    text = page_of(
        files(__package__) / "reproduction.md.j2",
        **_published(found),
        **_additional(of_additional),
        **_by_unit(found, list(base.units)),
        **_sensitivity([variant.name for variant in variants], found),
        weather=_weather_rows(by_weather),
        seen=[_who_sees(base, run_index) for run_index in heatmaps],
    )
    write_atomically(folder / "reproduction_heatmaps.png", picture)
    write_atomically(folder / "reproduction.md", text)


_Figures = Mapping[tuple[str, str], float]


def _range(values: Iterable[float]) -> str:
    numbers = list(values)
    low = percent(min(numbers))
    high = percent(max(numbers))
    if low == high:
        return low
    return f"{low} to {high}"


def _published(found: Sequence[_Figures]) -> dict[str, Any]:
    """Published figures beside ours."""
    rows = []
    for figure in load_published().figures:
        key = (figure.quantity, figure.case)
        ours = (percent(found[0][key]), _range(values[key] for values in found))
        told = f"{100.0 * figure.value:.2f} %"
        rows.append((*key, told, *ours, figure.use, figure.depends_on))
    return {"published": rows}


def _additional(by_variant: Mapping[str, _Figures]) -> dict[str, Any]:
    """The additional cases by variant.

    Explanations of the differences, and what is excluded.
    """
    figures = load_published().additional
    published = {(figure.quantity, figure.case): figure.published for figure in figures}
    cases = list(dict.fromkeys(figure.case for figure in figures))
    names = list(dict.fromkeys(figure.quantity for figure in figures))

    def shown(values: _Figures, case: str) -> str:
        known = [values[name, case] for name in names if (name, case) in values]
        return " / ".join(percent(value) for value in known) or "-"

    def of(name: str, case: str, who: str) -> str:
        return percent(by_variant[name][f"APR of {who}", case])

    def both(name: str, who: str) -> str:
        """A figure in both turning cases, or once where it is the same."""
        return " and ".join(dict.fromkeys(of(name, case, who) for case in TURNING))

    everyone = ("the VUT", "the best RSU", "any RSU")
    turned = [(f"APR of {who}", case) for who in everyone for case in TURNING]
    asked = {"LARGE_BOX": LARGE_BOX, "BEFORE": BEFORE, "BEHIND": BEHIND}
    asked |= {
        "BEHIND_NARROW": BEHIND_NARROW,
        "FARTHEST": FARTHEST,
        "SHORTEST": SHORTEST,
    }
    return asked | {
        "additional_names": names,
        "additional_cases": cases,
        "additional": [
            (
                "published",
                *(
                    " / ".join(published[name, case] for name in names)
                    for case in cases
                ),
            ),
            *(
                (name, *(shown(values, case) for case in cases))
                for name, values in by_variant.items()
            ),
        ],
        "is_read": all(name in by_variant for name in asked.values()),
        "of": of,
        "both": both,
        "quiet": [
            name
            for name, values in by_variant.items()
            if name != "as it is"
            and all(values.get(figure) == 1.0 for figure in turned)
        ],
    }


def _by_unit(found: Sequence[_Figures], units: Sequence[str]) -> dict[str, Any]:
    """Every unit by itself, those that avoid all, and what is not published."""
    told = [(kind, case) for kind in ("APR", "frames") for case in CASES]
    first = found[0]
    parties = ("the VUT", *units, "any RSU")
    published = {(figure.quantity, figure.case) for figure in load_published().figures}
    wanted = [
        (f"APR of {party}", case)
        for case in CASES
        for party in ("the VUT", "any RSU", *units)
    ]
    return {
        "unit_heads": [f"{kind} {case}" for kind, case in told],
        "units": [
            (
                party,
                *(percent(first[f"{kind} of {party}", case]) for kind, case in told),
            )
            for party in parties
        ],
        "best": [
            unit
            for unit in units
            if all(first[f"APR of {unit}", case] == 1.0 for case in CASES)
        ],
        "predictions": [
            (
                *figure,
                percent(first[figure]),
                _range(values[figure] for values in found),
            )
            for figure in wanted
            if figure not in published
        ],
    }


def _sensitivity(names: Sequence[str], found: Sequence[_Figures]) -> dict[str, Any]:
    """Figures by variant."""
    told = ("frames of the VUT", "APR of the VUT", "frames of any RSU")
    columns = [(quantity, case) for quantity in told for case in CASES]
    columns += [(f"APR of RSU{number}", "CPNC-50") for number in (0, 2, 3, 8)]
    return {
        "sensitivity_heads": [f"{quantity}, {case}" for quantity, case in columns],
        "sensitivity": [
            (name, *(percent(values[column]) for column in columns))
            for name, values in zip(names, found, strict=True)
        ],
    }


def _weather_rows(by_weather: dict[str, Evaluation]) -> list[tuple[str, ...]]:
    """APR by detector and weather."""
    rows = []
    for detector, evaluation in by_weather.items():
        axis = evaluation.axis
        for weather in WEATHERS:
            mask = np.array(axis.weathers) == weather
            cyclists = mask & np.isin(axis.cases, ["CBNA", "CBLA"])
            units = evaluation.units.values()
            alone = (
                float(np.mean([apr(verdict, axis, those) for verdict in units]))
                for those in (mask, cyclists)
            )
            together = (
                apr(evaluation.vut, axis, mask),
                apr(evaluation.rsu_all, axis, mask),
            )
            rows.append(
                (detector, weather, *map(percent, (together[0], *alone, together[1])))
            )
    return rows


def _who_sees(evaluation: Evaluation, run_index: int) -> str:
    """RSUs that detect in nearly all frames of a run.

    And in some before its last moment.
    """
    axis = evaluation.axis
    frames = axis.frames_of(run_index)
    in_time = axis.time_s[frames] <= axis.last_brake_time_s[run_index]
    nearly_all = []
    some = []
    for name, verdict in evaluation.units.items():
        detected = verdict.detected[frames]
        if detected.mean() >= _NEARLY_ALL:
            nearly_all.append(name)
        elif (detected & in_time).any():
            some.append(name)
    if evaluation.vut.is_avoided[run_index]:
        outcome = "brakes in time"
    else:
        outcome = "brakes too late"
    seen = axis.time_s[frames][evaluation.vut.detected[frames]]
    if len(seen):
        late_s = float(seen[0] - axis.last_brake_time_s[run_index])
        if late_s > 0.0:
            when = "after"
        else:
            when = "before"
        outcome += f", sees the VRU from {abs(late_s):.1f} s {when} the last moment on"
    return (
        f"* {axis.run_ids[run_index]}: the VUT alone {outcome}; in at least"
        f" {100.0 * _NEARLY_ALL:g} % of the frames: {', '.join(nearly_all) or 'none'};"
        f" in some before the last moment: {', '.join(some) or 'none'}."
    )


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("results"), show_default=True
)
def main(out: Path) -> None:
    """Write reproduction.md.

    The study's figures, ours, and what ours depend on.
    """
    progress = StageProgress()
    progress.start(quiet=False)
    try:
        write_reproduction(out, compute=Compute(progress=progress))
    except InputError as error:
        click.echo(str(error), err=True)
        raise SystemExit(2) from None
    finally:
        progress.stop()


if __name__ == "__main__":
    main()
