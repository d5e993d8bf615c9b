"""Layouts with proofs: wishes are checked, then stages solved in order, rung by rung.

Of a table that is too large, all poses are bounded by relaxation alone; the layout is
sought among those that gain most by its prices.
"""

import logging
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import FloatArray, IntArray
from geometry.clock import now_s
from geometry.errors import InputError, Unquoted
from geometry.phrases import Phrase

from ..detection_table import DetectionTable
from ..layout import Certificate, Stage, relative_gap
from . import constants
from .allowed_sets import Limits, cost_eur
from .bitsets import left_after_failures, shares_with_each, union_margins_s
from .bounds import find_root, polished, relaxation_text, rounded_down, run_rows
from .constants import COST_TOLERANCE_EUR, TOLERANCE, Deadline, Effort, deadline_in
from .greedy import forced_units, to_full
from .presolve import ALL_RULES, PresolveStatistics, ReducedProblem, Rule, presolve
from .problem import Floor, Objective, PlacementProblem, apr, objective_values
from .proof import Search, Stages

_log = logging.getLogger(__name__)


class UnmetError(InputError):
    """A wish that no layout meets, or none that was found."""


def check_limits(limits: Limits, pose_ids: Sequence[str]) -> None:
    """Check limits against each other, before anything is solved.

    Parameters
    ----------
    limits : Limits
        What may be mounted together.
    pose_ids : sequence of str
        Names of the poses in messages.

    Raises
    ------
    UnmetError
        Two of them cannot both be met: forced and forbidden, a site that is too
        small, money that does not suffice, rivals that are both forced, or no unit
        at all.
    """
    forced = np.flatnonzero(limits.is_forced)
    at_site = np.bincount(limits.site_index[forced], minlength=limits.n_sites)
    usable = (limits.site_capacity[limits.site_index] > 0) & ~limits.is_forbidden
    for pose in forced[limits.is_forbidden[forced]]:
        got = Unquoted("forced and forbidden")
        raise UnmetError(pose_ids[int(pose)], got, "one of the two at most")
    for site in np.flatnonzero(at_site > limits.site_capacity):
        there = forced[limits.site_index[forced] == site]
        names = ", ".join(pose_ids[int(pose)] for pose in there)
        got = Unquoted(f"{at_site[site]} at one site ({names})")
        expected = f"at most {limits.site_capacity[site]}, what the site can carry"
        raise UnmetError("forced units", got, expected)
    if not usable.any():
        got = Unquoted("none that may be used")
        raise UnmetError("candidates", got, "at least one")
    n_usable = np.bincount(limits.site_index[usable], minlength=limits.n_sites)
    if (limits.is_forced_site & (n_usable == 0)).any():
        got = Unquoted("a site without a pose that may be used")
        raise UnmetError("forced sites", got, "one or more")
    must_carry = limits.is_forced_site | (at_site > 0)
    if must_carry[limits.rivals].all(axis=1).any():
        got = Unquoted("two sites nearer than that which must both carry units")
        raise UnmetError("separation_m", got, "one of them at most")
    n_needed = len(forced) + int((limits.is_forced_site & (at_site == 0)).sum())
    if limits.budget_units is not None and n_needed > limits.budget_units:
        expected = Phrase(
            "at least {n}, the units that are forced or stand at forced sites",
            n=n_needed,
        )
        raise UnmetError("budget", limits.budget_units, expected)
    needed = cost_eur(limits, forced)
    what = "the price of the forced units"
    if not len(forced):
        price = limits.unit_cost_eur + limits.site_cost_eur[limits.site_index]
        needed = float(price[usable].min())
        what = "the price of the cheapest unit with its site"
    if limits.budget_eur is None:
        return
    if needed > limits.budget_eur + COST_TOLERANCE_EUR:
        expected = f"at least {needed:.2f} EUR, {what}"
        raise UnmetError("budget_cost", limits.budget_eur, expected)


def check_reach(problem: PlacementProblem, reduced: ReducedProblem) -> None:
    """Raise UnmetError unless all poses together reach every floor."""
    everything = np.bitwise_or.reduce(reduced.words, axis=0, keepdims=True)
    is_avoided = union_margins_s(reduced, everything) > -np.inf
    for floor, requirement in zip(problem.floors, reduced.floors, strict=True):
        reached = float(requirement.measure.of(is_avoided)[0])
        if reached < floor.share - TOLERANCE:
            raise UnmetError(
                floor.name,
                Unquoted(f"{floor.share:g}"),
                Phrase(
                    "at most {share}, which all candidate poses together reach",
                    share=_rounded_down(reached),
                ),
            )


def check_floors(problem: PlacementProblem, search: Search) -> None:
    """Check that the set that was found reaches all floors.

    Raises
    ------
    UnmetError
        It does not: out of reach, and the best that can be reached, or not found in
        time.
    """
    if search.units is not None and search.shortfall == 0.0:
        return
    reduced = search.reduced
    if search.units is None:
        why = "none was found"
        if search.nothing_meets_all:
            why = "no set of poses meets all of them"
        raise UnmetError("limits", Unquoted(why), "limits that leave a choice")
    sets = search.units[None, :]
    # The floor to which most is lacking.
    reached = []
    lacking = []
    for floor, requirement in zip(problem.floors, reduced.floors, strict=True):
        left = left_after_failures(
            reduced, requirement.measure, requirement.n_failures, sets
        )
        share = float(left[0])
        reached.append(share)
        lacking.append(floor.share - share)
    worst = int(np.argmax(lacking))
    floor = problem.floors[worst]
    most = _rounded_down(reached[worst])
    if floor.n_failures:
        most += f" when any {floor.n_failures} fail"
    expected = f"at most {most}, what the best set found reaches"
    if not search.nothing_meets_all:
        expected = (
            f"more time than the limit, or at most {most}, what the best set found in"
            " it reaches"
        )
    raise UnmetError(floor.name, Unquoted(f"{floor.share:g}"), expected)


def _rounded_down(share: float) -> str:
    """A share in four digits behind the point, never higher than it is."""
    return f"{np.floor(share * 1.0e4) / 1.0e4:g}"


def is_large(problem: PlacementProblem) -> bool:
    """True if a problem is better not solved as a whole."""
    return problem.table.n_poses * problem.table.axis.n_frames > constants.MAX_BITS


def of_pool(problem: PlacementProblem, pool: IntArray) -> PlacementProblem:
    """Problem on some of the poses."""
    whole = problem.table
    table = DetectionTable(
        pose_ids=tuple(whole.pose_ids[pose] for pose in pool),
        axis=whole.axis,
        packed=whole.packed[pool],
    )
    return replace(problem, table=table, limits=problem.limits.of_poses(pool))


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """Chosen poses, and how good they are proven to be.

    Attributes
    ----------
    pose_index : tuple of int
        Rows of the detection table, ascending.
    certificate : Certificate
        A stage for every objective, in order.
    presolve : PresolveStatistics
        What dropped out before.
    """

    pose_index: tuple[int, ...]
    certificate: Certificate
    presolve: PresolveStatistics


def solve_placement(
    problem: PlacementProblem,
    reduced: ReducedProblem | None = None,
    *,
    effort: Effort | None = None,
    starts: Sequence[IntArray] = (),
    n_stages: int | None = None,
    on_stage: Callable[[str], None] | None = None,
) -> Solution:
    """Best poses by the objectives in order, with a bound of each stage.

    By default the APR comes first, then the APR when one unit fails, the smallest
    margin, the mean margin, the cost. The bound of a stage is what no layout
    exceeds that is as good in all stages before.

    Parameters
    ----------
    problem : PlacementProblem
        The problem.
    reduced : ReducedProblem, optional
        The presolved problem, where that is at hand.
    effort : Effort, optional
        How hard to try.
    starts : sequence of (n,) int
        Rows of the table that are tried first, such as a good layout for a unit
        less.
    n_stages : int, optional
        Only so many objectives are bounded; by default all.
    on_stage : callable, optional
        Called with the name of every stage when it begins.

    Raises
    ------
    InputError
        Nothing meets the wishes: which one cannot be met, and the best that can; or
        nothing was found that does in the time given.
    """
    if effort is None:
        effort = Effort()
    deadline = deadline_in(effort.time_limit_s)
    check_limits(problem.limits, problem.table.pose_ids)
    if problem.limits.failing == "site":
        # No set is worth more where sites fail, and one whose units stand apart as
        # much: if it is best where units fail, it is best here. That is far quicker to
        # find: there, a pose may be replaced by one at another site.
        by_unit = replace(problem, limits=replace(problem.limits, failing="unit"))
        part = effort.until(deadline.of("as if units failed"))
        # Where sites fail, more may be possible than where units do; or the time was
        # too short.
        with suppress(UnmetError):
            found = solve_placement(
                by_unit,
                effort=part,
                starts=starts,
                n_stages=n_stages,
                on_stage=on_stage,
            )
            sites = problem.limits.site_index[list(found.pose_index)]
            if len(np.unique(sites)) == len(sites):
                return found
            starts = [*starts, np.array(found.pose_index)]
    if reduced is None and effort.solver != "exact" and is_large(problem):
        return _solve_large(problem, effort, deadline, n_stages, on_stage)
    if reduced is None:
        reduced = presolve(problem, workers=effort.workers)
    reduced = reduced.with_workers(effort.workers)
    check_reach(problem, reduced)
    search = Search(reduced, deadline=deadline, is_exact=effort.is_exact)
    search.start([units_of(reduced, poses) for poses in starts])
    check_floors(problem, search)
    # Stage after stage: the best set gets better, and its value is bounded.
    records = []
    plan = Stages(problem, search, effort).plan()
    for objective, find_bound in plan[:n_stages]:
        if on_stage is not None:
            on_stage(objective.value)
        began_s = now_s()
        bound = find_bound()
        seconds = now_s() - began_s
        records.append((objective, bound, seconds))
        _log.info("%s: bound %.6g after %.2f s", objective, bound, seconds)
    assert search.units is not None
    pose_index = to_full(reduced, search.units)
    values = objective_values(problem, pose_index)
    stages = tuple(build_stage(one, values[one], bound, s) for one, bound, s in records)
    solver = _joined([*search.proofs])
    return Solution(
        pose_index=pose_index,
        certificate=Certificate(stages=stages, solver=solver),
        presolve=reduced.statistics,
    )


def sturdy_problem(
    problem: PlacementProblem, highest: Solution, give_up: float
) -> PlacementProblem:
    """The problem in which what is left when a unit fails comes first.

    So much of the highest APR, a share, may be given up for it.
    """
    share = max(apr(problem, highest.pose_index) - give_up, 0.0)
    floor = Floor(name="give_up", share=share)
    return replace(problem, survive=1, floors=(*problem.floors, floor))


def solve_sturdily(
    problem: PlacementProblem,
    reduced: ReducedProblem | None = None,
    *,
    give_up: float,
    effort: Effort,
    on_stage: Callable[[str], None] | None = None,
) -> tuple[Solution, Solution | None]:
    """The layout of the highest APR; and the one that keeps most when a unit fails.

    The second is that of :func:`sturdy_problem`, on what the first was presolved
    to. It is None where nothing may be given up, for a single unit, and of a table
    that is too large to be solved as a whole.

    Raises
    ------
    InputError
        See :func:`solve_placement`.
    """
    deadline = deadline_in(effort.time_limit_s)
    has_two = give_up > 0.0 and problem.limits.max_units > 1 and not is_large(problem)
    first = effort
    if has_two:
        first = replace(effort, time_limit_s=effort.time_limit_s / 2.0)
    if has_two and reduced is None and problem.limits.failing == "unit":
        check_limits(problem.limits, problem.table.pose_ids)
        reduced = presolve(problem, workers=effort.workers)
    highest = solve_placement(problem, reduced, effort=first, on_stage=on_stage)
    if not has_two or len(highest.pose_index) < 2:
        return highest, None
    asked = sturdy_problem(problem, highest, give_up)
    if reduced is not None:
        reduced = reduced.for_problem(asked)
    sturdy = solve_placement(
        asked,
        reduced,
        effort=effort.until(deadline),
        starts=[np.array(highest.pose_index)],
        on_stage=on_stage,
    )
    return highest, sturdy


def units_of(reduced: ReducedProblem, poses: IntArray) -> IntArray:
    """Poses of the reduced problem; those that have dropped out are left out."""
    return np.flatnonzero(np.isin(reduced.pose_index, poses))


def _solve_large(
    problem: PlacementProblem,
    effort: Effort,
    deadline: Deadline,
    n_stages: int | None,
    on_stage: Callable[[str], None] | None,
) -> Solution:
    """The best among promising poses, bounded by the relaxation of all.

    What cannot be met is said of all poses only: where no layout of the pool meets the
    demands, the pool grows until it has all poses, which are then solved as a whole.
    """
    if on_stage is not None:
        on_stage("all poses")
    # A bound of all poses, and what each gains by its prices.
    rules = ALL_RULES - {Rule.DOMINATED_POSES}
    every = presolve(problem, workers=effort.workers, rules=rules)
    check_reach(problem, every)
    most = Search(every)
    apr = every.measure.limit
    gains = np.zeros(every.n_poses)
    if len(every.weight):
        end = deadline.of("relaxation")
        n_units = every.limits.max_units
        root = find_root(every, run_rows(every), n_units=n_units, deadline=end)
        root = polished(root)
        apr = min(rounded_down(every, root.limit), apr)
        gains = root.gains()
    # A layout among the poses that gain most; among more, until there is one.
    n_pool = constants.POOL_POSES
    found = None
    while found is None:
        pool = every.pose_index[_promising_poses(every, gains, n_pool)]
        try:
            found = _solve_pool(problem, pool, effort, deadline, n_stages, on_stage)
        except UnmetError as error:
            # What cannot be met is left to proofs.
            if len(pool) == every.n_poses:
                left = effort.until(deadline)
                whole = presolve(problem, workers=effort.workers)
                return solve_placement(
                    problem, whole, effort=left, n_stages=n_stages, on_stage=on_stage
                )
            if deadline.is_over:
                raise _unmet_by_pool(error, pool, every) from None
        n_pool *= constants.POOL_GROWTH
    # The stages of the layout, with bounds of all poses.
    value = {stage.name: stage.objective for stage in found.certificate.stages}
    avoided = 0.0
    if problem.tail == 1.0:
        avoided = value[Objective.APR]
    bounds = _loose_bounds(most, apr, avoided)
    stages = []
    for stage in found.certificate.stages:
        objective = Objective(stage.name)
        stages.append(
            build_stage(objective, stage.objective, bounds[objective], stage.seconds)
        )
    n_poses = problem.table.n_poses
    solver = Phrase(
        "{solver}: relaxation of all {n} poses, search among {n_pool}",
        solver=relaxation_text(),
        n=n_poses,
        n_pool=len(pool),
    )
    n_left = found.presolve.n_poses[1]
    return Solution(
        pose_index=tuple(int(pool[pose]) for pose in found.pose_index),
        certificate=Certificate(
            stages=tuple(stages),
            solver=solver,
        ),
        presolve=replace(found.presolve, n_poses=(n_poses, n_left)),
    )


def _joined(proofs: Sequence[Phrase]) -> Phrase:
    """What a proof rests on, for a certificate."""
    if not proofs:
        return Phrase("simple bounds, no solver")
    first, *others = proofs
    if not others:
        return first
    return Phrase("{proof} and {others}", proof=first, others=_joined(others))


def _promising_poses(every: ReducedProblem, gains: FloatArray, n_pool: int) -> IntArray:
    """Poses among which a layout of a large table is looked for, ascending.

    The `n_pool` that gain most by the relaxation's prices, (n_poses,), the forced ones,
    and what each demand needs by itself: the best poses and the cheapest one at every
    forced site, and those that avoid most of what a floor counts.
    """
    limits = every.limits
    wanted = [
        np.argsort(-gains, kind="stable")[:n_pool],
        np.flatnonzero(limits.is_forced),
    ]
    forced_sites = np.flatnonzero(limits.is_forced_site)
    n_each = -(-n_pool // max(len(forced_sites), 1))
    for site in forced_sites:
        there = np.flatnonzero(limits.site_index == site)
        wanted.append(there[np.argsort(-gains[there], kind="stable")[:n_each]])
        wanted.append(there[np.argsort(limits.unit_cost_eur[there], kind="stable")[:1]])
    n_each = -(-n_pool // max(len(every.floors), 1))
    for floor in every.floors:
        share = shares_with_each(every, forced_units(every), floor.measure)
        wanted.append(np.argsort(-share, kind="stable")[:n_each])
    return np.unique(np.concatenate(wanted))


def _solve_pool(
    problem: PlacementProblem,
    pool: IntArray,
    effort: Effort,
    deadline: Deadline,
    n_stages: int | None,
    on_stage: Callable[[str], None] | None,
) -> Solution:
    """The best among some poses, by search.

    Raises UnmetError if none of their sets will do.
    """
    part = of_pool(problem, pool)
    check_limits(part.limits, part.table.pose_ids)
    reduced = presolve(part, workers=effort.workers)
    effort = replace(effort.until(deadline), solver="greedy")
    return solve_placement(
        part, reduced, effort=effort, n_stages=n_stages, on_stage=on_stage
    )


def _unmet_by_pool(
    error: UnmetError, pool: IntArray, every: ReducedProblem
) -> UnmetError:
    """What is refused when the time is up before all poses were looked at."""
    expected = Phrase(
        "more time than the limit: no layout that meets the requirement was found"
        " among {n_looked_at} of {n_poses} poses",
        n_looked_at=len(pool),
        n_poses=every.n_poses,
    )
    return UnmetError(error.where, error.got, expected)


def _loose_bounds(every: Search, apr: float, avoided: float) -> dict[Objective, float]:
    """What all poses together reach, by objective.

    `apr` bounds the APR; `avoided` is the APR that is reached, which bounds the
    mean margin.
    """
    return dict.fromkeys(Objective, apr) | {
        Objective.UNITS: 1.0,
        Objective.COST: 0.0,
        Objective.SMALLEST_MARGIN: every.mean_margin_limit_s(0.0),
        Objective.MEAN_MARGIN: every.mean_margin_limit_s(avoided),
    }


def instead(
    problem: PlacementProblem,
    reduced: ReducedProblem,
    solution: Solution,
    pose_index: Sequence[int],
) -> Solution:
    """Other poses in place of a solution's, with what its bounds say of them.

    A stage's bound holds for poses that are as good as the solution's in all stages
    before; behind the first one in which they are not, stages have what all poses
    together reach.
    """
    values = objective_values(problem, pose_index)
    holds = True
    stages = []
    loose = _loose_bounds(Search(reduced), reduced.measure.limit, values[Objective.APR])
    for stage in solution.certificate.stages:
        one = Objective(stage.name)
        bound = loose[one]
        if holds:
            bound = stage.bound
        stages.append(build_stage(one, values[one], bound, stage.seconds))
        holds &= abs(values[one] - stage.objective) <= one.tolerance
    certificate = replace(solution.certificate, stages=tuple(stages))
    return replace(
        solution, pose_index=tuple(sorted(pose_index)), certificate=certificate
    )


def build_stage(
    objective: Objective, value: float, bound: float, seconds: float
) -> Stage:
    """A stage of a certificate, from a value and its bound.

    A bound that is worse than the value itself is not believed.
    """
    bound = objective.better(bound, value)
    gap = relative_gap(value, bound, tolerance=objective.tolerance)
    if gap == 0.0:
        bound = value
    return Stage(
        name=objective.value,
        objective=value,
        bound=bound,
        gap=gap,
        seconds=seconds,
    )
