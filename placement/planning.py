"""From a question to a plan: candidate poses, wishes, and how hard the optimiser tries."""

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.catalogue import Sensor, load_catalogue, pick_sensor
from geometry.errors import InputError, Unquoted
from geometry.files import pick
from geometry.scene import Scene

from .candidates import CandidateGrid, CandidatePose, build_candidates, load_candidate_grid
from .layout import Layout, check_layout, load_layout
from .optimiser import Effort, Failing
from .prices import load_prices
from .private_ground import (
    PrivateGround,
    load_private_ground,
    private_shares,
    respects_private_ground,
)
from .question import BASELINE_NAME, Question, split_names
from .study_layout import find_baseline, load_carlancap_layout
from .wishes import Wishes, check_wishes


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
    private_ground : PrivateGround, optional
        What cameras must not look into.
    may_look : function of poses, optional
        Which of them respect private ground, (n,) bool; None: all.
    """

    wishes: Wishes
    effort: Effort
    candidates: tuple[CandidatePose, ...]
    kept: Layout | None
    private_ground: PrivateGround | None = None
    may_look: Callable[[Sequence[CandidatePose]], BoolArray] | None = None


def build_plan(question: Question, scene: Scene) -> Plan:
    """Find out what a question asks for, and what there is to choose from.

    Parameters
    ----------
    question : Question
        A user's words.
    scene : Scene
        Its sites.

    Returns
    -------
    plan : Plan
        Candidates are the grid's, at the study's junction its 12 poses, and those kept; or those of
        `within` and those kept.

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
    if question.no_look_share and not question.no_look:
        raise InputError("--no-look-share", question.no_look_share, "--no-look beside it")
    kept, within = (
        _layout(name, option, scene, question.sensors)
        for name, option in ((question.keep, "--keep"), (question.within, "--within"))
    )
    if within is not None:
        candidates = tuple(_distinct([within, kept]))
    else:
        extra = _distinct([find_baseline(scene), kept])
        candidates = build_candidates(scene, build_grid(question), extra=extra)
    private_ground, may_look = None, None
    if question.no_look:
        private_ground = load_private_ground(Path(question.no_look), scene)
        may_look = partial(
            _respects, scene=scene, ground=private_ground, max_share=question.no_look_share or 0.0
        )
        candidates = tuple(compress(candidates, may_look(candidates)))
        if kept is not None:  # what hangs there hangs there
            candidates = tuple(_distinct([Layout(name="all", units=candidates), kept]))
    survive, failing = _failures(question.survive)
    wishes = Wishes(
        budget_units=question.budget,
        budget_eur=question.budget_cost,
        target=_target(question.target),
        saves=question.least,
        min_case_apr=question.min_case_apr,
        survive=survive,
        failing=failing,
        kept=() if kept is None else tuple(unit.id for unit in kept.units),
        forced_sites=split_names(question.force_site, "--force-site"),
        forbidden_sites=split_names(question.forbid_site, "--forbid-site"),
        site_capacity=question.site_capacity,
        site_cost_eur=question.site_cost_eur,
        prices=load_prices() if question.site_cost_eur is None and _asks_money(question) else None,
        separation_m=question.separation_m,
        tail=_tail(question.risk, question.samples),
    )
    check_wishes(wishes, scene)
    if within is not None and question.budget is not None and question.budget > len(candidates):
        raise InputError(
            "--budget", question.budget, f"at most {len(candidates)}, the units of --within"
        )
    return Plan(
        wishes=wishes,
        effort=build_effort(question),
        candidates=candidates,
        kept=kept,
        private_ground=private_ground,
        may_look=may_look,
    )


def _respects(
    candidates: Sequence[CandidatePose], *, scene: Scene, ground: PrivateGround, max_share: float
) -> BoolArray:
    return respects_private_ground(private_shares(scene, candidates, ground), max_share=max_share)


def build_effort(question: Question) -> Effort:
    """How hard the optimiser tries. Raises InputError for a number that cannot be."""
    return Effort(solver=question.solver, time_limit_s=question.time_limit_s, gap=question.gap)


def build_grid(question: Question, *, is_coarse: bool = False) -> CandidateGrid:
    """The default grid, with the sensors, heights, yaws and pitches of a question.

    Raises InputError if a sensor is unknown, or a number cannot be.
    """
    changes: dict[str, Any] = {}
    if question.sensors:
        changes["sensors"] = tuple(own_models(question.sensors).values())
    if question.heights:
        changes["heights_m"] = _numbers("--heights", question.heights, "metres", 0.5, 50.0)
    if question.pitches:
        changes["pitches_deg"] = _numbers("--pitches", question.pitches, "degrees", -90.0, 90.0)
    if question.yaw_step_deg is not None:
        changes["yaw_step_deg"] = question.yaw_step_deg
    try:
        return replace(load_candidate_grid(is_coarse=is_coarse), **changes)
    except InputError as error:
        if error.where != "grid.yaw_step_deg":
            raise
        raise InputError("--yaw-step", error.got, error.expected) from None


def _numbers(option: str, text: str, unit: str, low: float, high: float) -> FloatArray:
    """Numbers with commas between, each once."""
    expected = f"{unit} with commas between, {low:g} to {high:g}"
    numbers = [_number(option, word, expected, low, high) for word in split_names(text, option)]
    return np.array(numbers)


def own_models(sensors: str) -> dict[str, Sensor]:
    """Models by name, as a user lists them: of the catalogue, or of files."""
    names = split_names(sensors, "--sensors")
    return {model.name: model for name in names for model in _sensors(name)}


def _sensors(word: str) -> Sequence[Sensor]:
    """The model of a name; all of a catalogue FILE.toml, or FILE.toml:NAME."""
    path, _, name = word.rpartition(":")
    if word.endswith(".toml"):
        return list(load_catalogue(Path(word)).values())
    if path.endswith(".toml"):
        return [pick(load_catalogue(Path(path)), name, f"--sensors {path}")]
    return [pick_sensor(word, "--sensors")]


def find_layout(
    name: str | Path,
    option: str = "layout",
    *,
    scene: Scene | None = None,
    sensors: str = "",
) -> Layout:
    """A layout by its name (carlancap-12, the study's) or from a file; else an InputError.

    A list of units with places on earth takes the `scene`; `sensors` are models beside those of the
    catalogue, as a user lists them.
    """
    if str(name) == BASELINE_NAME:
        return load_carlancap_layout()
    if not os.path.lexists(name):
        raise InputError(option, str(name), f"{BASELINE_NAME}, or a layout file that exists")
    return load_layout(Path(name), scene=scene, sensors=own_models(sensors))


def _layout(name: str, option: str, scene: Scene, sensors: str) -> Layout | None:
    if not name:
        return None
    layout = find_layout(name, option, scene=scene, sensors=sensors)
    check_layout(layout, scene)
    return layout


def _distinct(layouts: Sequence[Layout | None]) -> list[CandidatePose]:
    """Units of some layouts, each id once; the last one that has it counts."""
    units = {unit.id: unit for layout in layouts if layout is not None for unit in layout.units}
    return list(units.values())


def _target(text: str) -> float | None:
    if not text:
        return None
    if text == "max":
        return np.inf
    return _number("--target", text, "a share of the runs from 0 to 1, or max", 0.0, 1.0)


def _asks_money(question: Question) -> bool:
    """Whether prices of sites decide about anything but ties."""
    return question.budget_cost is not None or bool(question.target and question.least == "cost")


def _failures(text: str) -> tuple[int, Failing]:
    """How many of what may fail: "2", "unit", "site", "2 sites"."""
    words = re.fullmatch(r"([0-9]{1,4})? ?(?:(unit|site)s?)?", text.strip())
    if not text.strip() or words is None:
        expected = "how many units may fail, at least 0, or unit, site, such as '2 sites'"
        raise InputError("--survive", text, expected)
    count, what = words.groups()
    return 1 if count is None else int(count), "site" if what == "site" else "unit"


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
