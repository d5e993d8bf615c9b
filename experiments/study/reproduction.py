"""The CarlaNCAP study's figures beside ours: ``python -m experiments.study.reproduction``."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path

import click
import numpy as np

from geometry.actors import PlacedActor
from geometry.catalogue import pick_camera
from geometry.errors import InputError
from geometry.files import (
    load_toml,
    take_list,
    take_number,
    take_text,
    write_atomically,
)
from geometry.poses import Pose, body_rotation
from geometry.scene import Scene
from geometry.scene_files import load_study_scene
from placement.compute import Compute, silent
from placement.detectors import GeometricDetector, load_planning_detector
from placement.evaluation import (
    Evaluation,
    Verdict,
    apr,
    detected_share,
)
from placement.evaluator import evaluate_layout
from placement.layout import Layout
from placement.question import Question
from placement.setting import Setting, build_setting
from scenarios.aeb import load_track_memory_s
from scenarios.exposure import weight_per_run
from scenarios.runs import Run, build_frame_axis

from ..figures.axes import to_png
from ..figures.evaluation import plot_heatmaps
from ..progress import StageProgress
from ..results.numbers import percent
from .layout import load_carlancap_layout

# ---------- the study's setting with one thing of our reconstruction changed


OWN_CASES = "CPNC-50,CBNA,CBLA"
"""The cases whose starts and figures the study publishes."""
# At the junction alone, every run alike, a track for ever once confirmed.
_AS_STUDIED = Question(cases=OWN_CASES, along_arms="0", weights="run", track_memory_s=math.inf)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Variant:
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


def build_variants() -> tuple[Variant, ...]:
    """As it is first; then walls, parked cars, smallest box and field of view, changed."""
    layout = load_carlancap_layout()
    base = build_setting(_AS_STUDIED, load_study_scene())
    changes: Mapping[str, Callable[[], Setting]] = {
        "as it is": lambda: base,
        "walls 0.5 m nearer to the corner": lambda: _move_walls(base, 0.5),
        "walls 5 m farther from the corner": lambda: _move_walls(base, -5.0),
        "no parked cars": lambda: _keep_parked(base, 0),
        "no parked cars, walls 5 m farther": lambda: _move_walls(_keep_parked(base, 0), -5.0),
        "two parked cars instead of eight": lambda: _keep_parked(base, 2),
        "parked row 1 m beside the VUT, not 0.5 m": lambda: _move_parked(base, 0.5),
        "smallest box 30 px": lambda: _detect_from(base, 30.0),
        "smallest box 50 px": lambda: _detect_from(base, 50.0),
    }
    variants = [
        Variant(name=name, setting=build(), layout=layout) for name, build in changes.items()
    ]
    narrow = pick_camera("carla-ncap-rgb-90", "variants")
    return (
        *variants,
        Variant(
            name="field of view 90 deg, not 110",
            setting=replace(base, vut_camera=narrow),
            layout=replace(
                layout, units=tuple(replace(unit, sensor=narrow) for unit in layout.units)
            ),
        ),
    )


def _move_walls(setting: Setting, by_m: float) -> Setting:
    """Every wall moved towards the middle of the junction, along both roads. [m]."""
    return replace(setting, scene=move_walls(setting.scene, by_m))


def move_walls(scene: Scene, by_m: float) -> Scene:
    """Move every wall towards the middle of a junction, by so much along both roads. [m].

    All else stands where it stood.
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
    return _with_runs(setting, lambda run: run.obstruction[:count])


def _move_parked(setting: Setting, by_m: float) -> Setting:
    """Parked bodies moved away from the VUT's path, to its right. [m]."""

    def moved(run: Run) -> tuple[PlacedActor, ...]:
        right = -body_rotation(float(run.vut_yaw_deg[0]))[:, 1]
        return tuple(
            PlacedActor(
                actor=parked.actor,
                pose=Pose(
                    position_m=parked.pose.position_m + by_m * right,
                    yaw_deg=parked.pose.yaw_deg,
                ),
            )
            for parked in run.obstruction
        )

    return _with_runs(setting, moved)


def _with_runs(setting: Setting, obstruction: Callable[[Run], tuple[PlacedActor, ...]]) -> Setting:
    runs = tuple(replace(run, obstruction=obstruction(run)) for run in setting.runs)
    return replace(setting, runs=runs)


def build_additional_variants() -> tuple[Variant, ...]:
    """Of the study's additional cases: as it is; then one thing changed that it leaves open."""
    layout = load_carlancap_layout()
    scene = load_study_scene()
    base = _additional(build_setting(Question(cases="study"), scene), "0")
    along = build_setting(
        Question(cases="study", along_arms="0,15,30", track_memory_s=math.inf), scene
    )
    live = replace(base, rule=replace(base.rule, track_memory_s=load_track_memory_s()))
    changes = {
        "as it is": base,
        f"a track lives for {live.rule.track_memory_s:g} s": live,
        "the last 5 s before the impact": _shorten(base, 5.0),
        "the last 3 s before the impact": _shorten(base, 3.0),
        "smallest box 60 px": _detect_from(base, 60.0),
        "15 m before the crosswalk": _additional(along, "-15"),
        "30 m before the crosswalk": _additional(along, "-30"),
    }
    return tuple(
        Variant(name=name, setting=setting, layout=layout) for name, setting in changes.items()
    )


def _additional(setting: Setting, position: str) -> Setting:
    """The runs of the additional cases at one position along the arms."""
    cases = {figure.case for figure in load_additional()}
    runs = [run for run in setting.runs if run.case.name in cases and run.position == position]
    return _of_runs(setting, runs)


def _shorten(setting: Setting, last_s: float) -> Setting:
    """Recordings that begin so long before the impact, if they began earlier. [s]."""

    def shorten(run: Run) -> Run:
        kept = run.time_s >= -last_s - _TOLERANCE_S
        names = ("time_s", "vut_position_m", "vut_yaw_deg", "vru_position_m", "vru_yaw_deg")
        return replace(run, **{name: getattr(run, name)[kept] for name in (*names, "vru_shape")})

    return _of_runs(setting, [shorten(run) for run in setting.runs])


_TOLERANCE_S = 1.0e-6


def _of_runs(setting: Setting, runs: Sequence[Run]) -> Setting:
    axis = build_frame_axis(runs, weight_per_run(runs))
    return replace(setting, runs=tuple(runs), axis=axis)


def _detect_from(setting: Setting, height_px: float) -> Setting:
    default = load_planning_detector()
    assert isinstance(default, GeometricDetector)
    detector = replace(default, min_box_height_px=height_px)
    return replace(setting, detector=detector, planner=detector)


# ---------- the study's figures beside ours


CASES = tuple(OWN_CASES.split(","))
HEATMAP_SPEEDS_KMH = {"CPNC-50": 55, "CBNA": 60, "CBLA": 50}  # the runs that the study draws
WEATHERS = ("day", "night", "rain", "fog")
DETECTORS = ("geometric", "response")
_NEARLY_ALL = 0.9


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedFigure:
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
    use: str
    depends_on: str


@cache
def load_published() -> tuple[PublishedFigure, ...]:
    """The study's figures, from ``data/carla_ncap_published.toml``."""
    where = "carla_ncap_published.toml"
    table = load_toml(files("experiments") / "data" / where)
    found = []
    for index, entry in enumerate(take_list(table, "figures", where)):
        here = f"{where}: figures[{index}]"
        use = take_text(entry, "use", here)
        if use not in ("set by it", "compared"):
            raise InputError(f"{here}.use", use, "'set by it' or 'compared'")
        found.append(
            PublishedFigure(
                quantity=take_text(entry, "quantity", here),
                case=take_text(entry, "case", here),
                value=take_number(entry, "value", here),
                use=use,
                depends_on=take_text(entry, "depends_on", here),
            )
        )
    return tuple(found)


@dataclass(frozen=True, slots=True, kw_only=True)
class AdditionalFigure:
    """A figure of the study's additional cases, another recording; nothing was fitted to it.

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


@cache
def load_additional() -> tuple[AdditionalFigure, ...]:
    """Figures of the additional cases, from ``data/carla_ncap_published.toml``."""
    where = "carla_ncap_published.toml"
    table = load_toml(files("experiments") / "data" / where)
    return tuple(
        AdditionalFigure(
            **{
                name: take_text(entry, name, f"{where}: additional[{index}]")
                for name in ("quantity", "case", "published")
            }
        )
        for index, entry in enumerate(take_list(table, "additional", where))
    )


def quantities(evaluation: Evaluation) -> dict[tuple[str, str], float]:
    """What the study publishes or leaves open, as shares of 1.

    By quantity and case.
    """
    axis = evaluation.axis
    parties: dict[str, Verdict] = {
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
    """Evaluate all variants and weathers, and write ``reproduction.md`` with its heatmaps."""
    variants, additional = build_variants(), build_additional_variants()
    n_steps = len(variants) + len(DETECTORS) + len(additional)
    evaluations = []
    quiet = replace(compute, progress=silent)
    for number, variant in enumerate(variants):
        compute.progress("evaluate variants", number, n_steps)
        evaluations.append(_evaluate(variant, quiet))
    by_weather = {}
    for number, detector in enumerate(DETECTORS, start=len(variants)):
        compute.progress("evaluate variants", number, n_steps)
        by_weather[detector] = _evaluate_weathers(detector, variants[0], quiet)
    of_additional = {}
    for number, variant in enumerate(additional, start=len(variants) + len(DETECTORS)):
        compute.progress("evaluate variants", number, n_steps)
        of_additional[variant.name] = quantities(_evaluate(variant, quiet))
    base = evaluations[0]
    heatmaps = [
        base.axis.run_ids.index(f"{case}/east/{speed}")
        for case, speed in HEATMAP_SPEEDS_KMH.items()
    ]
    picture = to_png(plot_heatmaps(base, heatmaps)[0])
    found = [quantities(evaluation) for evaluation in evaluations]
    names = [variant.name for variant in variants]
    text = "\n".join(
        [
            *_introduction(),
            *_published_table(found),
            *_additional_table(of_additional),
            *_units_table(found[0], list(base.units)),
            *_sensitivity_table(names, found),
            *_weather_table(by_weather),
            *_predictions(found, list(base.units)),
            "## Who sees whom when",
            "",
            "From the east; the dashed line is the last moment to brake, a diamond a confirmation.",
            "",
            *(_who_sees(base, run_index) for run_index in heatmaps),
            "",
            "The study, of CPNC-50 at 55 km/h: the VUT cannot brake in time; four RSUs see the VRU "
            "in nearly all frames, a fifth (RSU2) for some before the last moment.",
            "",
            "![Heatmaps of three runs](reproduction_heatmaps.png)",
            "",
        ]
    )
    write_atomically(folder / "reproduction_heatmaps.png", lambda file: file.write(picture))
    write_atomically(folder / "reproduction.md", lambda file: file.write(text.encode()))


def _evaluate(variant: Variant, compute: Compute) -> Evaluation:
    return evaluate_layout(variant.layout, variant.setting, compute=compute)


def _evaluate_weathers(detector: str, base: Variant, compute: Compute) -> Evaluation:
    question = replace(_AS_STUDIED, weather=",".join(WEATHERS), detector=detector)
    setting = build_setting(question, base.setting.scene)
    return evaluate_layout(base.layout, setting, compute=compute)


def _introduction() -> list[str]:
    return [
        "# The CarlaNCAP study, reproduced",
        "",
        "`python -m experiments.study.reproduction` evaluates the study's 12 cameras on its cases "
        "CPNC-50, CBNA and CBLA (104 runs, daylight) with its rules: IoU > 0.5, three frames in a "
        "row at 10 Hz, 25 ms, 7.72 m/s\N{SUPERSCRIPT TWO}. What Town05 has beside the road is not "
        "public; ours is a reconstruction, and the ranges say how much hangs on it: lowest and "
        "highest value over the variants below.",
        "",
    ]


def _range(values: Iterable[float]) -> str:
    numbers = list(values)
    low, high = percent(min(numbers)), percent(max(numbers))
    return low if low == high else f"{low} to {high}"


def _published_table(found: Sequence[dict[tuple[str, str], float]]) -> list[str]:
    rows = [
        (
            figure.quantity,
            figure.case,
            f"{100.0 * figure.value:.2f} %",
            percent(found[0][figure.quantity, figure.case]),
            _range(values[figure.quantity, figure.case] for values in found),
            figure.use,
            figure.depends_on,
        )
        for figure in load_published()
    ]
    header = ("quantity", "case", "published", "ours", "range", "use", "hangs on")
    return ["## Published and ours", "", *_table(header, rows), ""]


def _additional_table(by_variant: Mapping[str, Mapping[tuple[str, str], float]]) -> list[str]:
    rows = [
        (
            figure.case,
            figure.quantity,
            figure.published,
            *(
                percent(values[key]) if (key := (figure.quantity, figure.case)) in values else "-"
                for values in by_variant.values()
            ),
        )
        for figure in load_additional()
    ]
    return [
        "## The study's additional cases",
        "",
        "Another recording, by protocol 4.5.1; how its runs start and where they meet is not "
        "published, and nothing was fitted to its figures. Each column after the first changes one "
        "thing that the study leaves open: how long a track lives without detections, how long the "
        "recording is, how high in the image a road user must be, and where along the arm the "
        "bodies meet (at every third speed; turning cases have no other place).",
        "",
        *_table(("case", "quantity", "published", *by_variant), rows),
        "",
    ]


def _units_table(values: dict[tuple[str, str], float], units: Sequence[str]) -> list[str]:
    parties = ["the VUT", *units, "any RSU"]
    rows = [
        (
            party,
            *(percent(values[f"APR of {party}", case]) for case in CASES),
            *(percent(values[f"frames of {party}", case]) for case in CASES),
        )
        for party in parties
    ]
    header = (
        "",
        *(f"APR {case}" for case in CASES),
        *(f"frames {case}" for case in CASES),
    )
    best = [unit for unit in units if all(values[f"APR of {unit}", case] == 1.0 for case in CASES)]
    return [
        "## Every unit by itself",
        "",
        *_table(header, rows),
        "",
        f"Units that reach 100 % in all three cases: {', '.join(best) or 'none'} (the study: one "
        "RSU does; two to three cameras are enough for 100 % overall).",
        "",
    ]


def _sensitivity_table(
    names: Sequence[str], found: Sequence[dict[tuple[str, str], float]]
) -> list[str]:
    columns = [
        *(("frames of the VUT", case) for case in CASES),
        *(("APR of the VUT", case) for case in CASES),
        *(("frames of any RSU", case) for case in CASES),
        *((f"APR of RSU{number}", "CPNC-50") for number in (0, 2, 3, 8)),
    ]
    header = ("variant", *(f"{quantity}, {case}" for quantity, case in columns))
    rows = [
        (name, *(percent(values[column]) for column in columns))
        for name, values in zip(names, found, strict=True)
    ]
    return ["## Sensitivity", "", *_table(header, rows), ""]


def _weather_table(by_weather: dict[str, Evaluation]) -> list[str]:
    rows = []
    for detector, evaluation in by_weather.items():
        axis = evaluation.axis
        for weather in WEATHERS:
            mask = np.array(axis.weathers) == weather
            alone = [apr(verdict, axis, mask) for verdict in evaluation.units.values()]
            cyclists = mask & np.isin(axis.cases, ["CBNA", "CBLA"])
            rows.append(
                (
                    detector,
                    weather,
                    percent(apr(evaluation.vut, axis, mask)),
                    percent(float(np.mean(alone))),
                    percent(
                        float(np.mean([apr(v, axis, cyclists) for v in evaluation.units.values()]))
                    ),
                    percent(apr(evaluation.rsu_all, axis, mask)),
                )
            )
    header = ("detector", "weather", "VUT", "mean of RSUs", "the same, cyclists", "all RSUs")
    return [
        "## APR by weather",
        "",
        *_table(header, rows),
        "",
        "The study finds less than 3 points of change at night and in rain, a little more for "
        "cyclists in rain. Its figures are not given; fog it leaves to further work.",
        "",
    ]


def _who_sees(evaluation: Evaluation, run_index: int) -> str:
    """Which RSUs detect in nearly all frames of a run, and which in some before its last moment."""
    axis = evaluation.axis
    frames = axis.frames_of(run_index)
    in_time = axis.time_s[frames] <= axis.last_brake_time_s[run_index]
    nearly_all, some = [], []
    for name, verdict in evaluation.units.items():
        detected = verdict.detected[frames]
        if detected.mean() >= _NEARLY_ALL:
            nearly_all.append(name)
        elif (detected & in_time).any():
            some.append(name)
    outcome = "brakes in time" if evaluation.vut.is_avoided[run_index] else "brakes too late"
    return (
        f"* {axis.run_ids[run_index]}: the VUT alone {outcome}; in at least "
        f"{100.0 * _NEARLY_ALL:g} % of the frames: {', '.join(nearly_all) or 'none'}; in some "
        f"before the last moment: {', '.join(some) or 'none'}."
    )


def _predictions(found: Sequence[dict[tuple[str, str], float]], units: Sequence[str]) -> list[str]:
    published = {(figure.quantity, figure.case) for figure in load_published()}
    wanted = [
        (f"APR of {party}", case) for case in CASES for party in ("the VUT", "any RSU", *units)
    ]
    rows = [
        (
            quantity,
            case,
            percent(found[0][quantity, case]),
            _range(v[quantity, case] for v in found),
        )
        for quantity, case in wanted
        if (quantity, case) not in published
    ]
    return [
        "## Predictions",
        "",
        "Not published as numbers; nothing here was fitted to them.",
        "",
        *_table(("quantity", "case", "ours", "range"), rows),
        "",
    ]


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    return lines + ["| " + " | ".join(row) + " |" for row in rows]


@click.command()
@click.option("--out", type=click.Path(path_type=Path), default=Path("results"), show_default=True)
@click.option("--workers", type=int, default=2, show_default=True, help="Threads.")
@click.option("--quiet", is_flag=True, help="No progress on stderr.")
def main(out: Path, workers: int, quiet: bool) -> None:
    """Write reproduction.md: the study's figures, ours, and what ours hang on."""
    progress = StageProgress()
    progress.start(quiet=quiet)
    try:
        write_reproduction(out, compute=Compute(workers=workers, progress=progress))
    finally:
        progress.stop()


if __name__ == "__main__":
    main()
