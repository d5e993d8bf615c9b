"""The CarlaNCAP study's figures and ours: ``python -m experiments.study.reproduction``."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files
from itertools import count
from pathlib import Path
from typing import Any, Literal

import click
import msgspec
import numpy as np

from geometry.files import load_data, write_atomically
from placement.compute import Compute, silent
from placement.evaluation import Evaluation, apr, detected_share
from placement.evaluator import evaluate_layout
from placement.setting import build_setting

from ..figures.axes import to_png
from ..figures.evaluation import plot_heatmaps
from ..progress import StageProgress
from ..results.numbers import percent
from ..results.tables import page_of
from .variants import (
    AS_STUDIED,
    BEFORE,
    BEHIND,
    BEHIND_NARROW,
    FARTHEST,
    LARGE_BOX,
    OWN_CASES,
    SHORTEST,
    TURNING,
    Variant,
    build_additional_variants,
    build_variants,
)

CASES = tuple(OWN_CASES.split(","))
HEATMAP_SPEEDS_KMH = {"CPNC-50": 55, "CBNA": 60, "CBLA": 50}  # the runs that the study draws
WEATHERS = ("day", "night", "rain", "fog")
DETECTORS = ("geometric", "response")
_NEARLY_ALL = 0.9


class PublishedFigure(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A figure of the study: quantity as :func:`quantities` names it, case, and share of 1."""

    quantity: str
    case: str
    value: float
    use: Literal["set by it", "compared"]
    depends_on: str


class AdditionalFigure(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A figure of the study's additional cases, in its words; nothing was fitted to it."""

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
    """Figures that the study publishes or leaves open, as shares of 1, by quantity and case."""
    axis = evaluation.axis
    parties = {"the VUT": evaluation.vut, "any RSU": evaluation.rsu_all, **evaluation.units}
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
    steps = count()
    quiet = replace(compute, progress=silent)

    def evaluate(variant: Variant) -> Evaluation:
        compute.progress("evaluate variants", next(steps), n_steps)
        return evaluate_layout(variant.layout, variant.setting, compute=quiet)

    evaluations = [evaluate(variant) for variant in variants]
    by_weather = {}
    for detector in DETECTORS:
        question = replace(AS_STUDIED, weather=",".join(WEATHERS), detector=detector)
        setting = build_setting(question, variants[0].setting.scene)
        by_weather[detector] = evaluate(replace(variants[0], setting=setting))
    of_additional = {variant.name: quantities(evaluate(variant)) for variant in additional}
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
    low, high = percent(min(numbers)), percent(max(numbers))
    return low if low == high else f"{low} to {high}"


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
    """The additional cases by variant; explanations of the differences, and what is excluded."""
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
    asked |= {"BEHIND_NARROW": BEHIND_NARROW, "FARTHEST": FARTHEST, "SHORTEST": SHORTEST}
    return asked | {
        "additional_names": names,
        "additional_cases": cases,
        "additional": [
            ("published", *(" / ".join(published[name, case] for name in names) for case in cases)),
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
            if name != "as it is" and all(values.get(figure) == 1.0 for figure in turned)
        ],
    }


def _by_unit(found: Sequence[_Figures], units: Sequence[str]) -> dict[str, Any]:
    """Every unit by itself, those that avoid all, and what is not published."""
    told = [(kind, case) for kind in ("APR", "frames") for case in CASES]
    first, parties = found[0], ("the VUT", *units, "any RSU")
    published = {(figure.quantity, figure.case) for figure in load_published().figures}
    wanted = [
        (f"APR of {party}", case) for case in CASES for party in ("the VUT", "any RSU", *units)
    ]
    return {
        "unit_heads": [f"{kind} {case}" for kind, case in told],
        "units": [
            (party, *(percent(first[f"{kind} of {party}", case]) for kind, case in told))
            for party in parties
        ],
        "best": [
            unit for unit in units if all(first[f"APR of {unit}", case] == 1.0 for case in CASES)
        ],
        "predictions": [
            (*figure, percent(first[figure]), _range(values[figure] for values in found))
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
            together = apr(evaluation.vut, axis, mask), apr(evaluation.rsu_all, axis, mask)
            rows.append((detector, weather, *map(percent, (together[0], *alone, together[1]))))
    return rows


def _who_sees(evaluation: Evaluation, run_index: int) -> str:
    """RSUs that detect in nearly all frames of a run, and in some before its last moment."""
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
    seen = axis.time_s[frames][evaluation.vut.detected[frames]]
    if len(seen):
        late_s = float(seen[0] - axis.last_brake_time_s[run_index])
        when = "after" if late_s > 0.0 else "before"
        outcome += f", sees the VRU from {abs(late_s):.1f} s {when} the last moment on"
    return (
        f"* {axis.run_ids[run_index]}: the VUT alone {outcome}; in at least "
        f"{100.0 * _NEARLY_ALL:g} % of the frames: {', '.join(nearly_all) or 'none'}; in some "
        f"before the last moment: {', '.join(some) or 'none'}."
    )


@click.command()
@click.option("--out", type=click.Path(path_type=Path), default=Path("results"), show_default=True)
@click.option("--workers", type=int, default=2, show_default=True, help="Threads.")
@click.option("--quiet", is_flag=True, help="No progress on stderr.")
def main(out: Path, workers: int, quiet: bool) -> None:
    """Write reproduction.md: the study's figures, ours, and what ours depend on."""
    progress = StageProgress()
    progress.start(quiet=quiet)
    try:
        write_reproduction(out, compute=Compute(workers=workers, progress=progress))
    finally:
        progress.stop()


if __name__ == "__main__":
    main()
