"""From planning options to wishes, effort and candidates."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from geometry.catalogue import Sensor, load_catalogue, pick_sensor
from geometry.errors import InputError, Unquoted
from geometry.files import pick
from geometry.scene import Scene
from placement.candidates import (
    CandidateGrid,
    CandidatePose,
    build_candidates,
    load_candidate_grid,
)
from placement.layout import Layout, check_layout
from placement.optimiser import Effort
from placement.private_ground import PrivateGround, private_shares
from placement.question import Question
from placement.wishes import Wishes, check_wishes

from ..report.private_ground import is_decent, load_private_ground
from ..study.layout import find_baseline, find_layout


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """What is asked, and what there is to choose from.

    Attributes
    ----------
    wishes : Wishes
        Checked against the scene.
    effort : Effort
        Of the optimiser.
    candidates : tuple of CandidatePose
        Ids are unique.
    kept : Layout, optional
        What hangs there already.
    private : PrivateGround, optional
        What cameras must not look into.
    """

    wishes: Wishes
    effort: Effort
    candidates: tuple[CandidatePose, ...]
    kept: Layout | None
    private: PrivateGround | None = None


def build_plan(question: Question, scene: Scene) -> Plan:
    """Read planning options.

    Parameters
    ----------
    question : Question
        A user's words.
    scene : Scene
        Its sites.

    Returns
    -------
    plan : Plan
        Candidates are the grid's, the study's poses and those kept; or those of `within` alone.

    Raises
    ------
    InputError
        A word is unknown, a layout does not fit the scene, or a wish cannot be met at its sites.
    """
    for option, is_given in (
        ("--within", question.within),
        ("--samples", question.samples),
        ("--no-look", question.no_look),
    ):
        if question.refine and is_given:
            raise InputError(
                "--refine", Unquoted(f"it beside {option}"), "one of them: poses stay as they are"
            )
    for option, value in (
        ("--no-look-share", question.no_look_share),
        ("--no-look-price", question.no_look_price),
    ):
        if value and not question.no_look:
            raise InputError(option, value, "--no-look beside it")
    study = find_baseline(scene) if question.study_poses else None
    kept = _layout(question.keep, "--keep", scene)
    within = _layout(question.within, "--within", scene)
    if within is not None:
        candidates = tuple(_distinct([within, kept]))
    else:
        extra = _distinct([study, kept])
        candidates = build_candidates(scene, grid_of(question.sensors), extra=extra)
    private = None
    surcharges: tuple[tuple[str, float], ...] = ()
    if question.no_look:
        private = load_private_ground(Path(question.no_look), scene)
        most = question.no_look_share
        if most is None:
            most = 1.0 if question.no_look_price else 0.0
        shares = private_shares(scene, candidates, private)
        prices_eur = question.no_look_price * (shares @ private.area_m2)
        chosen = np.flatnonzero(is_decent(shares, most=most))
        surcharges = tuple(
            (candidates[row].id, float(prices_eur[row])) for row in chosen if prices_eur[row] > 0.0
        )
        candidates = tuple(candidates[row] for row in chosen)
        if kept is not None:  # what hangs there hangs there
            candidates = tuple(_distinct([Layout(name="all", units=candidates), kept]))
    wishes = Wishes(
        budget_units=question.budget,
        budget_eur=question.budget_cost,
        target=_target(question.target),
        saves=question.least,
        min_case_apr=question.min_case_apr,
        survive=question.survive,
        kept=() if kept is None else tuple(unit.id for unit in kept.units),
        forced_sites=_words(question.force_site),
        forbidden_sites=_words(question.forbid_site),
        site_capacity=question.site_capacity,
        site_cost_eur=question.site_cost_eur,
        separation_m=question.separation_m,
        surcharges_eur=surcharges,
        tail=_tail(question.risk, question.samples),
    )
    check_wishes(wishes, scene)
    if within is not None and question.budget is not None and question.budget > len(candidates):
        raise InputError(
            "--budget", question.budget, f"at most {len(candidates)}, the units of --within"
        )
    return Plan(
        wishes=wishes,
        effort=effort_of(question),
        candidates=candidates,
        kept=kept,
        private=private,
    )


def effort_of(question: Question) -> Effort:
    """How hard the optimiser tries.

    Raises
    ------
    InputError
        A number that cannot be.
    """
    return Effort(
        solver=question.solver,
        time_limit_s=question.time_limit_s,
        gap=question.gap,
    )


def grid_of(sensors: str) -> CandidateGrid:
    """The default grid, with sensors by name or from files, commas between; none: its own."""
    names = _words(sensors)
    if not names:
        return load_candidate_grid()
    models = {model.name: model for name in names for model in _sensors(name)}
    return replace(load_candidate_grid(), sensors=tuple(models.values()))


def _sensors(word: str) -> Sequence[Sensor]:
    """The model of a name; all of a catalogue FILE.toml, or FILE.toml:NAME."""
    path, _, name = word.rpartition(":")
    if word.endswith(".toml"):
        return list(load_catalogue(Path(word)).values())
    if path.endswith(".toml"):
        return [pick(load_catalogue(Path(path)), name, f"--sensors {path}")]
    return [pick_sensor(word, "--sensors")]


def _layout(name: str, option: str, scene: Scene) -> Layout | None:
    if not name:
        return None
    layout = find_layout(name, option)
    check_layout(layout, scene)
    return layout


def _distinct(layouts: Sequence[Layout | None]) -> list[CandidatePose]:
    """Units of some layouts, each id once; the last one that has it counts."""
    units = {unit.id: unit for layout in layouts if layout is not None for unit in layout.units}
    return list(units.values())


def _words(text: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))


def _target(text: str) -> float | None:
    if not text:
        return None
    if text == "max":
        return np.inf
    return _number("--target", text, "a share of the runs from 0 to 1, or max", 0.0, 1.0)


def _tail(risk: str, n_samples: int) -> float:
    if risk == "mean":
        return 1.0
    if n_samples == 0:
        raise InputError("--risk", risk, "mean, unless worlds are sampled (--samples)")
    if risk == "worst":
        return 1.0 / n_samples
    tail = _number("--risk", risk, "mean, worst, or a share of the worst worlds", 0.0, 1.0)
    if tail == 0.0:
        raise InputError("--risk", risk, "mean, worst, or a share of the worst worlds, more than 0")
    return tail


def _number(option: str, text: str, expected: str, low: float, high: float) -> float:
    try:
        number = float(text)
    except ValueError:
        number = np.nan
    if not low <= number <= high or not np.isfinite(number):
        raise InputError(option, text, expected)
    return number
