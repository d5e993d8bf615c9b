"""From a question to a layout: the assembly, and the search.

Everything that an answer needs is assembled here and nowhere else.
"""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import compress, count
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import BoolArray
from geometry.errors import InputError, Unquoted
from geometry.phrases import Phrase
from geometry.registry import load_entry
from geometry.scene import Scene
from geometry.scene_sources import load_scene

from .cache import cached_value
from .candidates import CandidateGrid, CandidatePose, build_candidates, build_grid
from .compute import DEFAULT_COMPUTE, Compute, RunTasks, run_here
from .detection_table import DetectionTable, mixed_table
from .evaluator import with_sight
from .explain.contributions import NextUnit, find_next_unit
from .forbidden_views import (
    ForbiddenAreas,
    load_forbidden_areas,
    respects_private_ground,
)
from .layout import (
    Certificate,
    Layout,
    at_sites,
    check_layout,
    find_baseline,
    find_layout,
)
from .located_choice import LocatedChoice
from .memory import check_memory
from .optimiser import (
    Effort,
    Limits,
    PlacementProblem,
    PresolveStatistics,
    ReducedProblem,
    Solution,
    UnmetError,
    presolve,
    solve_greedy,
    solve_sturdily,
    sturdy_problem,
)
from .optimiser.problem import Fusion, Objective, apr, objective_values
from .optimiser.solve import instead
from .question import BLIND, N_JUDGED, SEE, Question, read_cars
from .sampling.out_of_sample import APART, SampledApr, out_of_sample_layouts
from .sampling.tables import SampledTable, obtain_table, sampled_table
from .sampling.uncertainty import Uncertainty, load_drawn
from .sampling.worlds import repeat_heavy_runs
from .setting import Setting, build_setting
from .wishes import Wishes, build_limits, build_problem, read_wishes

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, eq=False)
class Assembly:
    """A question made ready for every answer.

    Table and problem are built once, when they are first asked for. Another
    assembly with other candidates or wishes is made by ``dataclasses.replace``.

    Attributes
    ----------
    setting : Setting
        Scene, runs, braking rule, detectors.
    candidates : sequence of CandidatePose
        Poses to choose from: rows of the table. Ids are unique.
    wishes : Wishes
        Demands on a layout.
    fusion : Fusion
        "any": a frame counts if any unit detects; "single": one unit must
        confirm alone.
    effort : Effort
        How hard the optimiser tries.
    existing : Layout, optional
        What is mounted already.
    private_ground : ForbiddenAreas, optional
        What cameras must not look into.
    may_look : callable, optional
        Which poses respect private ground, (n,) bool; None: all.
    uncertainty : Uncertainty, optional
        What is drawn in sampled worlds.
    n_samples : int
        Worlds to choose in; 0: the one as planned.
    first_sample : int
        Number of the first of them.
    compute : Compute
        Seed, threads, cache of tables, progress.
    known_table : DetectionTable, optional
        Table of the candidates where there is one already.
    """

    setting: Setting
    candidates: Sequence[CandidatePose]
    wishes: Wishes = field(default_factory=Wishes)
    fusion: Fusion = "any"
    effort: Effort = field(default_factory=Effort)
    existing: Layout | None = None
    private_ground: ForbiddenAreas | None = None
    may_look: Callable[[Sequence[CandidatePose]], BoolArray] | None = None
    uncertainty: Uncertainty | None = None
    n_samples: int = 0
    first_sample: int = 0
    compute: Compute = DEFAULT_COMPUTE
    known_table: DetectionTable | None = None

    def __post_init__(self) -> None:
        if not self.candidates:
            raise InputError("candidates", Unquoted("none"), "at least one pose")

    def __repr__(self) -> str:
        return f"Assembly({self.setting!r}, {len(self.candidates)} poses)"

    @property
    def scene(self) -> Scene:
        """The scene of the setting."""
        return self.setting.scene

    @cached_property
    def limits(self) -> Limits:
        """Limits on what may be mounted together; needs no table."""
        return build_limits(self.wishes, self.scene, self.candidates)

    @cached_property
    def table(self) -> DetectionTable:
        """Detections of all candidates, from the cache or built.

        With sampled worlds they are the detections in these. Raises InputError if
        it does not fit into the memory of this machine.
        """
        if self.known_table is not None:
            return self.known_table
        if self._sampled is not None:
            return self._sampled.table
        check_memory(len(self.candidates), self.setting.axis.n_frames)
        return obtain_table(self.setting, self.candidates, compute=self.compute)

    @cached_property
    def _sampled(self) -> SampledTable | None:
        """Table of the sampled worlds; None in the world as planned."""
        if self.uncertainty is None or self.n_samples == 0:
            return None
        setting = self.setting
        if self.uncertainty.draws_anew:
            setting = repeat_heavy_runs(setting, most=self.uncertainty.most_draws)
        check_memory(
            len(self.candidates), setting.axis.n_frames, n_worlds=self.n_samples
        )
        return sampled_table(
            setting,
            self.candidates,
            self.uncertainty,
            n_samples=self.n_samples,
            first=self.first_sample,
            compute=self.compute,
        )

    @cached_property
    def problem(self) -> PlacementProblem:
        """The optimiser's problem.

        With a share of cars that see, each run is there twice, see
        :func:`placement.detection_table.mixed_table`.
        """
        # Start from the table of the plain runs, in one world or in many.
        setting = with_sight(self.setting, compute=self.compute)
        table = self.table
        if setting.cars:
            seen = setting.seen_by_vut
        else:
            seen = None
        sample_index = None
        if self._sampled is not None:
            seen = self._sampled.seen_by_vut
            sample_index = self._sampled.sample_index
        # With a share of cars that see, each run is there twice.
        if seen is not None and setting.cars < 1.0:
            table = mixed_table(table, setting.cars)
            seen = np.concatenate([seen, np.zeros_like(seen)])
            if sample_index is not None:
                sample_index = np.tile(sample_index, 2)
        return build_problem(
            setting,
            self.candidates,
            table,
            wishes=self.wishes,
            limits=self.limits,
            fusion=self.fusion,
            sample_index=sample_index,
            seen_by_vut=seen,
        )

    @cached_property
    def presolved(self) -> ReducedProblem:
        """The problem after presolve."""
        reduced = presolve(self.problem, workers=self.effort.workers)
        _log.info("presolve: %s", reduced.statistics)
        return reduced

    def in_fresh_worlds(
        self,
        layouts: Sequence[Layout],
        *,
        n_worlds: int,
        first: int = APART,
        run: RunTasks = run_here,
    ) -> list[SampledApr]:
        """Judge layouts in the same fresh worlds, in which none was chosen.

        `first` is the number of the first world; `run` says where worlds are looked
        at.
        """
        # `assemble` reads it with every question.
        assert self.uncertainty is not None
        return out_of_sample_layouts(
            self.setting,
            layouts,
            self.uncertainty,
            n_samples=n_worlds,
            first=first,
            fusion=self.fusion,
            compute=self.compute,
            run=run,
        )


def assemble(
    question: Question,
    *,
    scene: Scene | None = None,
    setting: Setting | None = None,
    grid: CandidateGrid | None = None,
    existing: Layout | None = None,
    counts_money: bool = False,
    compute: Compute = DEFAULT_COMPUTE,
) -> Assembly:
    """Make a question ready for every answer.

    All of it is checked before any ray is cast. `scene` is in place of the one that
    the question names; `setting` has scene and runs where they have been laid
    already. `grid` has the poses to try at each site, in place of the question's
    grid and the study's poses; `existing` is in place of the mounted units that the
    question names. With `counts_money`, sites without a price cost what is assumed,
    also where no money is asked for.

    Candidates are the grid's, at the study's junction its 12 poses, and the existing
    units; or those of `within` and the existing ones. Raises InputError: a word is
    unknown, a layout does not fit the scene, a wish cannot be met at its sites, or no
    run can be laid.
    """
    # Words first: a misspelt question is refused before anything is loaded.
    _check_together(question)
    if scene is None:
        if setting is None:
            scene = load_scene(question.scene)
        else:
            scene = setting.scene
    if existing is None:
        existing = _named_layout(question.keep, "keep", scene, question.sensors)
    if existing is not None:
        existing = at_sites(existing, scene)
    # Poses to choose from, less those that look into private ground.
    units = () if existing is None else existing.units
    candidates = _candidates(question, scene, grid, units)
    private_ground = None
    may_look = None
    if question.no_look:
        private_ground = load_forbidden_areas(Path(question.no_look), scene)
        may_look = partial(
            _respects,
            scene=scene,
            ground=private_ground,
            max_share=question.no_look_share or 0.0,
        )
        # Existing units stay, wherever they look.
        candidates = _distinct([*compress(candidates, may_look(candidates))], units)
    # Demands are checked against the sites before any run is laid.
    wishes = read_wishes(question, existing=units, counts_money=counts_money)
    build_limits(wishes, scene, candidates)
    # What is drawn in sampled worlds, and how hard the optimiser tries.
    uncertainty = load_drawn(question, scene, n_samples=question.n_samples)
    if question.packet_loss:
        uncertainty = replace(uncertainty, packet_loss=question.packet_loss)
    effort = build_effort(question, compute)
    if setting is None:
        compute.progress(Phrase("setting"), 0, 0)
        setting = build_setting(question, scene, compute=compute)
    return Assembly(
        setting=with_sight(setting, compute=compute),
        candidates=candidates,
        wishes=wishes,
        fusion=question.fusion,
        effort=effort,
        existing=existing,
        private_ground=private_ground,
        may_look=may_look,
        uncertainty=uncertainty,
        n_samples=question.n_samples,
        compute=compute,
    )


def _check_together(question: Question) -> None:
    """Raise InputError for fields that exclude or need one another."""
    for field_name in ("within", "samples", "no_look"):
        if question.refine and getattr(question, field_name):
            got = Unquoted(f"it beside `{field_name}`")
            raise InputError("refine", got, "one of them: poses stay as they are")
    if question.refine and 0.0 < read_cars(question.cars) < 1.0:
        raise InputError("cars", question.cars, f"{BLIND} or {SEE} beside `refine`")
    if question.no_look_share and not question.no_look:
        raise InputError("no_look_share", question.no_look_share, "`no_look` beside it")


def _candidates(
    question: Question,
    scene: Scene,
    grid: CandidateGrid | None,
    existing: Sequence[CandidatePose],
) -> tuple[CandidatePose, ...]:
    """Candidate poses of a question: the grid's, or those of `within`."""
    # A question may name its poses itself.
    within = _named_layout(question.within, "within", scene, question.sensors)
    if within is not None:
        return _distinct(within.units, existing)
    if grid is not None:
        return build_candidates(scene, grid, extra=existing)
    # At the study's junction, its poses are among the candidates.
    study = find_baseline(scene)
    extra = _distinct(() if study is None else study.units, existing)
    return build_candidates(scene, build_grid(question), extra=extra)


def _named_layout(name: str, where: str, scene: Scene, sensors: str) -> Layout | None:
    """Layout that a question names, checked; None for an empty name."""
    if not name:
        return None
    layout = find_layout(name, where, scene=scene, sensors=sensors)
    check_layout(layout, scene)
    return layout


def _distinct(*several: Sequence[CandidatePose]) -> tuple[CandidatePose, ...]:
    """Units, each id once; the last one that has it counts."""
    return tuple({unit.id: unit for units in several for unit in units}.values())


def _respects(
    candidates: Sequence[CandidatePose],
    *,
    scene: Scene,
    ground: ForbiddenAreas,
    max_share: float,
) -> BoolArray:
    """True for candidates that respect private ground, (n,) bool."""
    return respects_private_ground(
        ground.shares(scene, candidates), max_share=max_share
    )


def build_effort(question: Question, compute: Compute = DEFAULT_COMPUTE) -> Effort:
    """How hard the optimiser tries. Raises InputError for a number that cannot be."""
    return Effort(
        solver=question.solver,
        time_limit_s=question.time_limit_s,
        gap=question.gap,
        workers=compute.workers,
    )


# ---------- the best layout

FOUND = "found"
"""Name of the layout found, where fresh worlds compare it with the greedy one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Highest:
    """Layout of the highest APR, where another one is chosen.

    The chosen one loses less when a unit fails.

    Attributes
    ----------
    layout : Layout
        The layout.
    pose_index : tuple of int
        Rows of the table that make it.
    certificate : Certificate
        Proof that its APR is the highest.
    problem : PlacementProblem
        The problem that it solves.
    given_up : float
        APR that might be given up.
    """

    layout: Layout
    pose_index: tuple[int, ...]
    certificate: Certificate
    problem: PlacementProblem
    given_up: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placement:
    """Result of the optimiser, and the problem that it solved.

    Attributes
    ----------
    layout : Layout
        The best layout.
    greedy : Layout
        The layout that plain greedy search finds within the same limits.
    greedy_index : tuple of int
        Rows of the table that make `greedy`, where it was found; a refinement
        has its own table.
    certificate : Certificate
        Proof of `layout`.
    presolve : PresolveStatistics
        What was left of the problem before any solver started.
    problem : PlacementProblem
        The problem, with the detection table.
    pose_index : tuple of int
        Rows of the table that make `layout`.
    nominal : PlacementProblem
        The layout alone in the world as planned, its runs as they are:
        `problem` itself unless worlds were sampled, or a share of the cars sees:
        then with cars that do not.
    nominal_index : tuple of int
        Rows of its table that make `layout`.
    seconds : mapping of str to float
        Time per stage. [s]
    presolved : callable, optional
        What presolve left of it, found when first asked for; None: layouts were
        moved since.
    next_unit : NextUnit, optional
        What greedy choice would add to `layout`, budgets aside; None: nothing
        fits, or not known.
    highest : Highest, optional
        None where nothing of the APR might be given up.
    preferred : (SampledApr, SampledApr), optional
        `layout` and the one of the layout found and the greedy one that was not
        taken, in fresh worlds that decided it; None: they were not asked.
    located : LocatedChoice, optional
        `layout`, where it is the one of a pool that locates best; None: not asked.
    """

    layout: Layout
    greedy: Layout
    greedy_index: tuple[int, ...]
    certificate: Certificate
    presolve: PresolveStatistics
    problem: PlacementProblem
    pose_index: tuple[int, ...]
    nominal: PlacementProblem
    nominal_index: tuple[int, ...]
    seconds: Mapping[str, float]
    presolved: Callable[[], ReducedProblem] | None = None
    next_unit: NextUnit | None = None
    highest: Highest | None = None
    preferred: tuple[SampledApr, SampledApr] | None = None
    located: LocatedChoice | None = None

    def __repr__(self) -> str:
        proof = "not proven"
        if self.is_proven:
            proof = "proven"
        return f"Placement({self.layout!r}, {proof})"

    @property
    def is_proven(self) -> bool:
        """True if every stage is, also those of the highest APR."""
        if self.highest is not None and not self.highest.certificate.is_proven:
            return False
        return self.certificate.is_proven

    def __str__(self) -> str:
        return f"{self.layout}\n\n{self.certificate}"

    def _repr_html_(self) -> str:
        return self.layout._repr_html_() + self.certificate._repr_html_()


@dataclass(frozen=True, slots=True)
class _Answer:
    """What the optimiser says of a problem."""

    first: Solution
    sturdy: Solution | None
    greedy_index: tuple[int, ...]
    next_unit: NextUnit | None

    @property
    def is_proven(self) -> bool:
        solutions = (self.first, self.sturdy)
        return all(one is None or one.certificate.is_proven for one in solutions)


def place(assembly: Assembly, *, asks_worlds: bool = False) -> Placement:
    """Find the best layout of an assembly.

    With `asks_worlds`, greedy choice's layout is taken in place of the one found where
    fresh worlds prefer it, see :func:`may_prefer`; its certificate has what is proven
    of both. Raises InputError: nothing is asked for, wishes cannot be met (the message
    says which, and how little has to give way), or the question does not fit into the
    memory of this machine.
    """
    wishes = assembly.wishes
    compute = assembly.compute
    effort = assembly.effort
    if (
        wishes.budget_units is None
        and wishes.budget_eur is None
        and wishes.target is None
    ):
        raise InputError(
            "budget", Unquoted("nothing"), "`budget`, `budget_cost` or `target`"
        )
    # What cannot be met is refused before anything is computed.
    _ = assembly.limits
    # Detections first, then the optimiser.
    started = time.perf_counter()
    table = assembly.table
    table_done = optimised = time.perf_counter()
    _log.info(
        "detection table: %d poses, %d frames", table.n_poses, table.axis.n_frames
    )
    problem = assembly.problem

    def answer() -> _Answer:
        """Solve the problem, and look for the greedy layout next to it."""
        nonlocal optimised
        reduced = assembly.presolved
        first, sturdy = solve_sturdily(
            problem,
            reduced,
            give_up=wishes.give_up,
            effort=effort,
            on_stage=lambda stage: compute.progress(
                Phrase("optimise: {goal}", goal=stage), 0, 0
            ),
        )
        optimised = time.perf_counter()
        compute.progress(Phrase("greedy"), 0, 0)
        greedy_index = solve_greedy(problem, reduced)
        if sturdy is None:
            chosen = first
        else:
            chosen = sturdy
        next_unit = find_next_unit(problem, reduced, chosen.pose_index)
        return _Answer(first, sturdy, greedy_index, next_unit)

    compute.progress(Phrase("optimise"), 0, 0)
    found = _cached(assembly, answer)
    preferred = None
    if asks_worlds:
        found, preferred = _by_worlds(assembly, found)
    pick = partial(pick_layout, assembly.candidates)
    # Where failures cost less with another layout, that one is the answer.
    solution = found.first
    highest = None
    located = None
    asked = problem
    if wishes.located_m is not None:
        found, located = _by_location(assembly, found, wishes.located_m)
        solution = found.first
    if found.sturdy is not None:
        highest = Highest(
            layout=pick(solution.pose_index, f"highest-{len(solution.pose_index)}"),
            pose_index=solution.pose_index,
            certificate=solution.certificate,
            problem=problem,
            given_up=wishes.give_up,
        )
        asked = sturdy_problem(problem, solution, wishes.give_up)
        solution = found.sturdy
    nominal, nominal_index = _nominal(assembly, asked, solution.pose_index)
    return Placement(
        layout=pick(solution.pose_index, f"best-{len(solution.pose_index)}"),
        greedy=pick(found.greedy_index, f"greedy-{len(found.greedy_index)}"),
        greedy_index=found.greedy_index,
        certificate=solution.certificate,
        presolve=solution.presolve,
        problem=asked,
        presolved=lambda: assembly.presolved,
        pose_index=solution.pose_index,
        nominal=nominal,
        nominal_index=nominal_index,
        next_unit=found.next_unit,
        highest=highest,
        preferred=preferred,
        located=located,
        seconds={
            "detection_table": table_done - started,
            "optimise": optimised - table_done,
            "greedy": time.perf_counter() - optimised,
        },
    )


def _by_worlds(
    assembly: Assembly, found: _Answer
) -> tuple[_Answer, tuple[SampledApr, SampledApr] | None]:
    """Replace the layout by the greedy one if fresh worlds prefer that.

    The second value has both in these worlds, the one that is taken first. And the
    other one, both there; None where these worlds are not asked.
    """
    problem = assembly.problem
    first = found.first
    greedy = found.greedy_index
    chosen = first
    asked = problem
    if found.sturdy is not None:
        chosen = found.sturdy
        asked = sturdy_problem(problem, first, assembly.wishes.give_up)
    if not may_prefer(assembly, asked, chosen, greedy):
        return found, None
    assembly.compute.progress(
        Phrase("optimised or greedy layout, in fresh worlds"), 0, 0
    )
    names = {FOUND: chosen.pose_index, "greedy": greedy}
    both = [
        pick_layout(assembly.candidates, rows, name) for name, rows in names.items()
    ]
    of_found, of_greedy = assembly.in_fresh_worlds(both, n_worlds=N_JUDGED)
    if not is_preferred(of_greedy.apr_by_sample, of_found.apr_by_sample):
        return found, (of_found, of_greedy)
    reduced = assembly.presolved
    sturdy = None
    if (
        found.sturdy
        and apr(asked, greedy) >= asked.floors[-1].share - Objective.APR.tolerance
    ):
        # No more is given up than may be.
        sturdy = instead(asked, reduced, found.sturdy, greedy)
    if sturdy is None or first.pose_index == chosen.pose_index:
        first = instead(problem, reduced, first, greedy)
    next_unit = find_next_unit(problem, reduced, (sturdy or first).pose_index)
    return _Answer(first, sturdy, greedy, next_unit), (of_greedy, of_found)


def _by_location(
    assembly: Assembly, found: _Answer, limit_m: float
) -> tuple[_Answer, LocatedChoice | None]:
    """Replace the layout by the one of a pool that locates road users in most runs.

    Its certificate has what is proven of the layout that would be chosen otherwise.
    """
    # By name: a placement that does not ask for it loads none of it.
    find_located = load_entry("placement.located:find_located")
    problem = assembly.problem
    wishes = assembly.wishes
    first = found.first
    usual = found.sturdy or first
    least_apr = max(apr(problem, first.pose_index) - wishes.give_up, 0.0)
    starts = [usual.pose_index, first.pose_index, found.greedy_index]
    choice = cached_value(
        assembly.compute.cache_folder,
        "located",
        lambda: find_located(
            assembly.setting,
            assembly.candidates,
            problem,
            starts,
            limit_m=limit_m,
            least_apr=least_apr,
            compute=assembly.compute,
        ),
        kind=LocatedChoice,
        made_from=(problem, starts, limit_m, least_apr, assembly.candidates),
        packages=("geometry", "scenarios", "placement"),
    )
    asked = problem
    reduced = assembly.presolved
    if found.sturdy is not None:
        asked = sturdy_problem(problem, first, wishes.give_up)
    solution = instead(asked, reduced.for_problem(asked), usual, choice.pose_index)
    next_unit = find_next_unit(problem, reduced, choice.pose_index)
    if found.sturdy is None:
        return _Answer(solution, None, found.greedy_index, next_unit), choice
    return _Answer(first, solution, found.greedy_index, next_unit), choice


def may_prefer(
    assembly: Assembly,
    problem: PlacementProblem,
    solution: Solution,
    greedy: Sequence[int],
) -> bool:
    """True if fresh worlds decide between the layout found and the greedy one.

    Worlds that were chosen in are few, and the plan knows nothing of chance: they
    decide wherever worlds were sampled or detections are drawn. By rule, the plan
    decides; unless cars see and both layouts are as good up to the APR, for then it
    tells nothing. Something else than the highest APR is left as it was asked for.
    """
    wishes = assembly.wishes
    setting = assembly.setting
    # Anything but the highest APR is left as it was asked for.
    is_other = wishes.target is not None or wishes.survive > 0 or wishes.tail < 1.0
    is_other |= wishes.min_case_apr > 0.0
    is_same = set(greedy) == set(solution.pose_index) or len(greedy) > len(
        solution.pose_index
    )
    if is_other or is_same:
        return False
    if assembly.n_samples or setting.table_detector.is_drawn:
        return True
    if not setting.cars:
        return False
    values = objective_values(problem, greedy)
    stages = {Objective(stage.name): stage for stage in solution.certificate.stages}
    first = [*stages][: [*stages].index(Objective.APR) + 1]
    return all(
        abs(values[one] - stages[one].objective) <= one.tolerance for one in first
    )


def is_preferred(greedy: ArrayLike, found: ArrayLike) -> bool:
    """True if greedy choice's layout has the higher mean; APR (n_worlds,) of both.

    Both are within the budget: the better estimate decides, be it beyond doubt or not.
    """
    return bool(np.mean(np.subtract(greedy, found)) > 0.0)


def _cached(assembly: Assembly, answer: Callable[[], _Answer]) -> _Answer:
    """An answer from the cache, or a new one.

    Raises InputError if wishes cannot be met.
    """
    problem = assembly.problem
    wishes = assembly.wishes
    effort = assembly.effort
    try:
        return cached_value(
            assembly.compute.cache_folder,
            "answer",
            answer,
            kind=_Answer,
            made_from=(problem, effort, wishes.give_up),
            is_worth_it=lambda found: found.is_proven,
        )
    except UnmetError as error:
        assembly.compute.progress(Phrase("find conflicting requirements"), 0, 0)
        # By name: only whose wishes cannot be met needs it.
        find_refusal = load_entry("placement.explain.conflicts:find_refusal")
        refusal: InputError | None = find_refusal(
            problem,
            wishes,
            assembly.scene,
            assembly.candidates,
            time_limit_s=effort.time_limit_s,
        )
        raise refusal or error from None


def _nominal(
    assembly: Assembly, problem: PlacementProblem, pose_index: tuple[int, ...]
) -> tuple[PlacementProblem, tuple[int, ...]]:
    """The problem without chance, and the rows of a layout in it."""
    # The plan: no share of cars, no sampled worlds.
    cars = assembly.setting.cars
    plain = replace(assembly.setting, cars=float(cars == 1.0))
    if problem.sample_index is not None:
        units = [assembly.candidates[index] for index in pose_index]
        compute = replace(assembly.compute.within("greedy"), cache_folder=None)
        alone = Assembly(
            setting=plain, candidates=units, fusion=assembly.fusion, compute=compute
        )
        return alone.problem, tuple(range(len(units)))
    if 0.0 < cars < 1.0:
        return (
            replace(assembly, setting=plain, known_table=assembly.table).problem,
            pose_index,
        )
    return problem, pose_index


def pick_layout(
    candidates: Sequence[CandidatePose], pose_index: Sequence[int], name: str
) -> Layout:
    """Layout of some candidates by their rows; poses of the grid get short names.

    A name that a unit of another layout brings along is not given again.
    """
    # Names of the grid hold a slash; they get the first free short name.
    chosen = [candidates[index] for index in pose_index]
    taken = {candidate.id for candidate in chosen}
    free = (name for name in (f"U{number}" for number in count(1)) if name not in taken)
    return Layout(
        name=name,
        units=tuple(
            replace(candidate, id=next(free)) if "/" in candidate.id else candidate
            for candidate in chosen
        ),
    )
