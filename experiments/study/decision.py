"""What a decision to brake makes of layouts, and what decides it.

``python -m experiments.study.decision`` writes ``results/decision.md`` and its figures.
"""

import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from geometry.arrays import FloatArray
from geometry.errors import InputError
from geometry.footprints import footprint_corners
from geometry.writing import write_atomically
from placement.compute import Compute
from placement.decisions import LayoutDecisions, judge_decisions
from placement.evaluation import Evaluation
from placement.evaluator import evaluate_again, evaluate_layouts
from placement.evaluator.evaluate import unit_key, watch
from placement.layout import Layout, load_carlancap_layout
from placement.question import Question
from placement.sampling.uncertainty import BY_EYE, CALIBRATED
from placement.setting import Setting
from scenarios.decision import DecisionRule, load_decision_rule
from scenarios.runs import Run, build_frame_axis, frames_at
from scenarios.twins import MAIN_KINDS, build_twins

from ..export.watched import (
    Followed,
    WatchedRun,
    ellipse_points_m,
    follow_watched,
)
from ..figures.axes import BLUE, WIDTH_IN, new_figure, show_square, to_png
from ..figures.plan import draw_scene, plot_plan
from ..jobs.search import search
from ..parts.decision_judging import build_layout
from ..parts.decision_section import plot_decisions
from ..progress import StageProgress, tell
from ..results.numbers import percent
from ..results.tables import page_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COMMAND = "uv run python -m experiments.study.decision"
BUDGET = 3
LIMITS = (0.05, 0.10, 0.25)
"""Twins that a rule may brake for, where the best one is sought."""
LIMIT = 0.10
AIMS_DEG = (0.1, 0.2, 0.5, 1.0, 2.0)
LATENCIES_S = (0.025, 0.1, 0.2, 0.3)
CONFIRMATIONS = (3, 5, 7)
FAST_HZ = 20.0
LIDAR = "carla-ncap-lidar"
DEFAULT = "default three"
LOCATED = "located 0.40 m"
CLOSER = "located 0.35 m"
TWELVE = "the study's twelve"
_METRES = {LOCATED: "0.4", CLOSER: "0.35"}
_VARIED = (DEFAULT, LOCATED, TWELVE)
_STRIP_RUN = "CPNC-50/east/40"
_STRIP_S = (-2.4, -1.8, -1.2, -0.8, -0.4)
_STRIP_HALF_M = 6.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Studied:
    """Layouts by name, and what they were judged in."""

    setting: Setting
    evaluations: dict[str, Evaluation]
    decisions: dict[str, LayoutDecisions]


@dataclass(frozen=True, slots=True, kw_only=True)
class DecisionVariant:
    """A change, and what layouts avoid with it.

    Attributes
    ----------
    words : str
        What is changed.
    avoided : tuple of float
        By the best rule that brakes for so many of the twins as LIMIT says: calibrated
        and by eye for each of the varied layouts, in their order. 0 .. 1
    """

    words: str
    avoided: tuple[float, ...]


# ---------- layouts
def find_layouts(*, compute: Compute, progress: StageProgress) -> dict[str, Layout]:
    """The layouts that are compared, by name; the default one first."""
    found = {}
    questions = {
        DEFAULT: Question(budget=BUDGET),
        LOCATED: Question(budget=BUDGET, located_m=0.40),
        CLOSER: Question(budget=BUDGET, located_m=0.35),
    }
    for name, question in questions.items():
        placed = search(question, compute=compute, progress=progress).placement
        found[name] = replace(placed.layout, name=name)
        if name == DEFAULT:
            greedy = replace(placed.greedy, name="greedy three")
            assert placed.highest is not None
            highest = replace(placed.highest.layout, name="highest APR")
    return {
        **found,
        highest.name: highest,
        greedy.name: greedy,
        TWELVE: replace(load_carlancap_layout(), name=TWELVE),
    }


def study(*, compute: Compute, progress: StageProgress) -> Studied:
    """Find, evaluate and judge the layouts by decision."""
    job = search(Question(budget=BUDGET), compute=compute, progress=progress).job
    layouts = find_layouts(compute=compute, progress=progress)
    judged = evaluate_layouts([*layouts.values()], job.setting, compute=compute)
    decisions = judge_decisions(
        judged, job.setting, load_decision_rule(), compute=compute
    )
    return Studied(
        setting=job.setting,
        evaluations=dict(zip(layouts, judged, strict=True)),
        decisions=dict(zip(layouts, decisions, strict=True)),
    )


# ---------- what is varied
def find_variants(studied: Studied, *, compute: Compute) -> list[DecisionVariant]:
    """One thing changed at a time, for the layouts that are varied."""
    setting = studied.setting
    rule = load_decision_rule()
    evaluations = [studied.evaluations[name] for name in _VARIED]
    aims = {f"{aim:g}": (aim, aim) for aim in AIMS_DEG}
    by_aim = judge_decisions(evaluations, setting, rule, aims=aims, compute=compute)
    found = [
        DecisionVariant(
            words=f"aims known to {aim}°",
            avoided=tuple(_best(one, aim) for one in by_aim),
        )
        for aim in aims
    ]
    changes = [
        *(
            (f"{n} confirming frames", replace(setting.rule, n_confirmations=n))
            for n in CONFIRMATIONS
        ),
        *(
            (
                f"latency {1000.0 * latency_s:g} ms",
                replace(setting.rule, latency_s=latency_s),
            )
            for latency_s in LATENCIES_S
        ),
    ]
    for words, aeb in changes:
        changed = replace(setting, rule=aeb)
        again = evaluate_again(evaluations, setting, changed, compute=compute)
        found.append(_variant(words, again, changed, rule, compute=compute))
    # At 20 Hz frames are nearer to each other, and so are the errors of their boxes.
    aeb = replace(setting.rule, frame_rate_hz=FAST_HZ)
    runs = tuple(at_frame_rate(run, FAST_HZ) for run in setting.runs)
    axis = build_frame_axis(runs, setting.axis.weight)
    fast = replace(setting, rule=aeb, runs=runs, axis=axis, seen_by_vut=None)
    share = setting.rule.frame_rate_hz / FAST_HZ
    fast_rule = replace(rule, box_correlation=rule.box_correlation**share)
    layouts = [one.layout for one in evaluations]
    again = evaluate_layouts(layouts, fast, compute=compute)
    found.append(_variant("20 Hz, not 10", again, fast, fast_rule, compute=compute))
    return found


def at_frame_rate(run: Run, frame_rate_hz: float) -> Run:
    """The same run, seen in frames that are as far apart as another rate says."""
    n_steps = round(-float(run.time_s[0]) * frame_rate_hz)
    time_s = np.arange(-n_steps, 1) / frame_rate_hz
    return replace(run, **frames_at(run.encounter, time_s))


def find_others(
    studied: Studied, *, compute: Compute, progress: StageProgress
) -> list[DecisionVariant]:
    """Other units in place of the default three: fewer, and LiDARs."""
    questions = {
        "one camera": Question(budget=1),
        "two cameras": Question(budget=2),
        "three cameras": Question(budget=3),
        "three LiDARs": Question(budget=3, sensors=LIDAR),
    }
    found = []
    for words, question in questions.items():
        job = search(question, compute=compute, progress=progress)
        layout = job.placement.layout
        evaluations = evaluate_layouts([layout], studied.setting, compute=compute)
        rule = load_decision_rule()
        found.append(
            _variant(words, evaluations, studied.setting, rule, compute=compute)
        )
    return found


def _variant(
    words: str,
    evaluations: Sequence[Evaluation],
    setting: Setting,
    rule: DecisionRule,
    *,
    compute: Compute,
) -> DecisionVariant:
    judged = judge_decisions(evaluations, setting, rule, compute=compute)
    shares = [_best(one, aimed) for one in judged for aimed in (CALIBRATED, BY_EYE)]
    return DecisionVariant(words=words, avoided=tuple(shares))


def _best(decisions: LayoutDecisions, aimed: str) -> float:
    share, _, _ = decisions.by_aim[aimed].best_rule(LIMIT)
    return share


# ---------- figures
def plot_plans(studied: Studied) -> "Figure":
    """The default layout and the one that locates, side by side."""
    figure = new_figure(2.0 * WIDTH_IN, WIDTH_IN + 2.4)
    for axes, name in zip(figure.subplots(1, 2), (DEFAULT, CLOSER), strict=True):
        layout = studied.evaluations[name].layout
        plot_plan(studied.setting, layout, axes=axes)
        axes.set_title(name)
        axes.set_anchor("N")
    return figure


def plot_strip(studied: Studied, *, compute: Compute) -> "Figure":
    """Some moments of a run, and of its twin: ellipses, ways ahead, braking."""
    setting = studied.setting
    numbers = {run.id: number for number, run in enumerate(setting.runs)}
    number = numbers[_STRIP_RUN]
    twin = next(
        one
        for one in build_twins(setting.runs, load_decision_rule())
        if one.of_run == number and one.kind in MAIN_KINDS
    )
    layout = studied.evaluations[DEFAULT].layout
    figure = new_figure(2.0 * WIDTH_IN, 0.42 * 2.0 * WIDTH_IN)
    rows = figure.subplots(2, len(_STRIP_S))
    shown = {"the run": setting.runs[number], "its twin": twin.run}
    for axes_of_row, (words, run) in zip(rows, shown.items(), strict=True):
        axis = build_frame_axis((run,), np.ones(1))
        alone = replace(setting, runs=(run,), axis=axis, seen_by_vut=None)
        units = {unit_key(unit): unit for unit in layout.units}
        seen = watch(alone, units, compute=compute)
        watched = WatchedRun(
            run=run,
            detected={unit.id: seen[unit_key(unit)] for unit in layout.units},
            rule=setting.rule,
        )
        followed = follow_watched(watched, layout.units)
        middle_m = setting.runs[number].vru_position_m[-1]
        for axes, time_s in zip(axes_of_row, _STRIP_S, strict=True):
            frame = int(np.argmin(np.abs(run.time_s - time_s)))
            draw_scene(axes, setting.scene)
            _draw_moment(axes, run, followed, frame)
            show_square(axes, middle_m, _STRIP_HALF_M)
            told = "brakes" if followed.brakes[frame] else "drives on"
            axes.set_title(f"{words}, {time_s:g} s: {told}", fontsize=8)
            axes.set_xticks([])
            axes.set_yticks([])
    return figure


def _draw_moment(axes: "Axes", run: Run, followed: Followed, frame: int) -> None:
    """The bodies of a frame, and what the car knows and foresees."""
    bodies = (
        (run.encounter.vut, run.vut_position_m[frame], run.vut_yaw_deg[frame], "0.25"),
        (run.encounter.vru, run.vru_position_m[frame], run.vru_yaw_deg[frame], BLUE),
    )
    for actor, middle_m, yaw_deg, colour in bodies:
        corners_m = footprint_corners(
            middle_m, yaw_deg, length_m=actor.length_m, width_m=actor.width_m
        )
        axes.fill(*corners_m.T, color=colour, zorder=6)
    ahead_s = np.linspace(0.0, followed.ahead_s, 20)
    motion = run.encounter.vut_motion
    way_m, _ = motion.path.at(motion.distance_m(run.time_s[frame] + ahead_s))
    axes.plot(*way_m.T, color="0.25", lw=1.2, zorder=5)
    if not followed.tracks.is_live[frame]:
        return
    state = followed.tracks.state[0, frame]
    covariance_m2 = followed.tracks.covariance[frame, :2, :2]
    ellipse_m = ellipse_points_m(state[:2], covariance_m2)
    closed_m = np.concatenate([ellipse_m, ellipse_m[:1]])
    axes.plot(*closed_m.T, color=BLUE, lw=1.0, zorder=7)
    foreseen_m = state[:2] + ahead_s[:, None] * state[2:]
    axes.plot(*foreseen_m.T, "--", color=BLUE, lw=1.2, zorder=7)


# ---------- the page
def text(
    studied: Studied,
    variants: Sequence[DecisionVariant],
    others: Sequence[DecisionVariant],
) -> str:
    """The page, as Markdown."""
    rows = []
    for name, one in studied.decisions.items():
        figures = [one.detected_apr, one.twins_detected]
        for aimed in (CALIBRATED, BY_EYE):
            decided = one.by_aim[aimed]
            figures += [decided.best_rule(limit)[0] for limit in LIMITS]
            figures.append(decided.located(0.40))
        rows.append([name, str(len(one.layout.units)), *map(percent, figures)])
    names = (DEFAULT, LOCATED, CLOSER)
    by_eye = {name: _at_limits(studied, name, BY_EYE) for name in names}
    calibrated = {name: _at_limits(studied, name, CALIBRATED) for name in names}
    gains = {name: 100.0 * (by_eye[name] - by_eye[DEFAULT]) for name in names[1:]}
    at_limit = LIMITS.index(LIMIT)
    recommended = max(gains, key=lambda name: float(gains[name][at_limit]))
    calibrated_gain = calibrated[recommended] - calibrated[DEFAULT]
    return page_of(
        files(__package__) / "decision.md.j2",
        command=COMMAND,
        rule=load_decision_rule(),
        rows=rows,
        limit=f"{100.0 * LIMIT:g} %",
        default={
            CALIBRATED: percent(float(calibrated[DEFAULT][at_limit])),
            BY_EYE: percent(float(by_eye[DEFAULT][at_limit])),
        },
        gains={name: [f"{gain:+.0f}" for gain in gains[name]] for name in gains},
        recommended=_METRES[recommended],
        metres=_METRES,
        calibrated_gain=f"{100.0 * calibrated_gain[at_limit]:+.0f}",
        moved=_moved(studied, recommended),
        located={
            name: _located(studied, name, float(_METRES[recommended]))
            for name in (DEFAULT, recommended)
        },
        varied=_VARIED,
        variants=_rows(one for one in variants if len(one.avoided) > len(_VARIED)),
        by_aim=_rows(one for one in variants if len(one.avoided) == len(_VARIED)),
        others=_rows(others),
        strip_run=_STRIP_RUN,
    )


def _at_limits(studied: Studied, name: str, aimed: str) -> FloatArray:
    """Shares avoided by the best rules at each of LIMITS, (n_limits,)."""
    decided = studied.decisions[name].by_aim[aimed]
    return np.array([decided.best_rule(limit)[0] for limit in LIMITS])


def _located(studied: Studied, name: str, limit_m: float) -> str:
    """Share of the runs located so well with aims by eye, in per cent."""
    return percent(studied.decisions[name].by_aim[BY_EYE].located(limit_m))


def _moved(studied: Studied, name: str) -> str:
    """Poles that a layout leaves and takes, against the default one."""
    before = {unit.site_id for unit in studied.evaluations[DEFAULT].layout.units}
    after = {unit.site_id for unit in studied.evaluations[name].layout.units}
    left = ", ".join(sorted(before - after)) or "none"
    taken = ", ".join(sorted(after - before)) or "none"
    stays = ", ".join(sorted(before & after)) or "none"
    return f"it keeps {stays}, leaves {left} and takes {taken}"


def _rows(variants: Iterable[DecisionVariant]) -> list[list[str]]:
    return [[one.words, *map(percent, one.avoided)] for one in variants]


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("results"), show_default=True
)
def main(out: Path) -> None:
    """Write decision.md and its figures."""
    progress = StageProgress()
    progress.start(quiet=False)
    try:
        out.mkdir(parents=True, exist_ok=True)
        # The questions share one detection table.
        with tempfile.TemporaryDirectory() as folder:
            compute = Compute(progress=progress, cache_folder=Path(folder))
            _write(out, compute=compute, progress=progress)
    except InputError as error:
        tell(str(error), err=True)
        raise SystemExit(2) from None


def _write(out: Path, *, compute: Compute, progress: StageProgress) -> None:
    studied = study(compute=compute, progress=progress)
    variants = find_variants(studied, compute=compute)
    others = find_others(studied, compute=compute, progress=progress)
    rule = load_decision_rule()
    records = [
        build_layout(name, one, rule.reserve_s, rule.threshold)
        for name, one in studied.decisions.items()
    ]
    figures: dict[str, Axes | Figure] = {
        "curves": plot_decisions(records),
        "plan": plot_plans(studied),
        "strip": plot_strip(studied, compute=compute),
    }
    for name, figure in figures.items():
        write_atomically(out / f"decision_{name}.png", to_png(figure))
    write_atomically(out / "decision.md", text(studied, variants, others))


if __name__ == "__main__":
    main()
