"""Fourth rung: the placement model, solved by HiGHS.

One function states one family of constraints. The variables are

* x_c = 1: pose c is chosen;
* o_s = 1: site s carries a unit;
* y_f: frame f, or tail, is seen;
* z_w: window w is seen as a whole;
* a_k: one of the windows of a chain up to its k-th link is live; run r is
  avoided if a of its last link in time is 1.

Only x has to be whole: given x, every y, z and a is bounded from above by zeros
and ones alone, and from below by nothing but what must be avoided: their
largest values are zeros and ones.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.clock import now_s
from geometry.phrases import Phrase

from . import constants
from .allowed_sets import Limits
from .bitsets import union_margins_s, unions_of
from .bounds import Rows, margin_rows, run_rows
from .constants import COST_TOLERANCE_EUR, TOLERANCE
from .presolve import ReducedProblem
from .problem import Measure, Objective, Requirement, WordArray

if TYPE_CHECKING:
    import cvxpy as cp
    import scipy.sparse as sp


@dataclass(frozen=True, slots=True, kw_only=True)
class SolverAnswer:
    """Answer of a solver to a problem that is maximised.

    Attributes
    ----------
    is_found : bool
        True if the variables hold a feasible point.
    is_finished : bool
        True if that is best, or there is none, not just the best within the time.
    bound : float
        Of all feasible points; minus infinity: there is none, plus infinity:
        nothing is known.
    """

    is_found: bool
    is_finished: bool
    bound: float


def solver_text() -> Phrase:
    """Solver and versions, for a certificate."""
    return Phrase(
        "HiGHS {highs} through cvxpy {cvxpy}",
        highs=version("highspy"),
        cvxpy=version("cvxpy"),
    )


def run_solver(
    problem: cp.Problem, *, time_limit_s: float, gap: float = 0.0
) -> SolverAnswer:
    """Maximise in bounded variables by HiGHS, as far as the time goes.

    Parameters
    ----------
    problem : cvxpy.Problem
        What is maximised. Its variables get the values that were found.
    time_limit_s : float
        Time to compile the problem for the solver and to solve it. [s]
    gap : float
        Relative gap at which the solver stops.
    """
    import cvxpy as cp

    nothing = SolverAnswer(is_found=False, is_finished=False, bound=np.inf)
    begun_s = now_s()
    with warnings.catch_warnings():
        # cvxpy calls a solution inaccurate when the time was up.
        warnings.filterwarnings("ignore", "Solution may be inaccurate")
        try:
            data, chain, inverse = problem.get_problem_data("HIGHS")
            # Compiling takes longer than stating.
            left_s = time_limit_s - (now_s() - begun_s)
            if left_s <= 0.0:
                return nothing
            options = {
                "time_limit": min(left_s, constants.LONGEST_S),
                "mip_rel_gap": gap,
                "mip_abs_gap": 0.0,
            }
            solution = chain.solve_via_data(
                problem, data, warm_start=False, verbose=False, solver_opts=options
            )
            problem.unpack_results(solution, chain, inverse)
        except cp.SolverError:
            # Nothing is known then, and nothing is lost.
            return nothing
    # All variables are bounded: what may be unbounded is infeasible.
    infeasible = (cp.INFEASIBLE, cp.settings.INFEASIBLE_OR_UNBOUNDED)
    if problem.status in infeasible:
        return SolverAnswer(is_found=False, is_finished=True, bound=-np.inf)
    info = problem.solver_stats.extra_stats
    return SolverAnswer(
        # kSolutionStatusFeasible.
        is_found=info.primal_solution_status == 2,
        is_finished=problem.status == cp.OPTIMAL,
        # Cvxpy minimises the negative.
        bound=-info.mip_dual_bound,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cut:
    """At least so many of some poses must be chosen, or poses at so many sites.

    Attributes
    ----------
    is_counted : (n_poses,) bool
        Poses that count.
    n_units : int
        How many of them, or of their sites where sites fail, are needed.
    """

    is_counted: BoolArray
    n_units: int


class MilpResult(NamedTuple):
    """Answer of the solver to a placement model, in the objective's unit.

    Attributes
    ----------
    units : (n,) int, optional
        Poses of the reduced problem; None if no feasible set was found.
    bound, is_finished
        Those of :class:`SolverAnswer`.
    """

    units: IntArray | None
    bound: float
    is_finished: bool


def limit_constraints(
    x: cp.Variable, o: cp.Variable, limits: Limits
) -> list[cp.Constraint]:
    """Limits: units, money, capacity, what is forced or too near.

    1 <= sum x <= K; unit costs @ x + site costs @ o <= budget; sum of the x of a
    site <= its capacity; x_c <= o_s; x_c = 1 for forced poses; sum of the x of a
    forced site >= 1; o_s + o_t <= 1 for rivals.

    Parameters
    ----------
    x : cvxpy.Variable, (n_poses,)
        Poses that are chosen.
    o : cvxpy.Variable, (n_sites,)
        Sites that carry any.
    limits : Limits
        What may be mounted together.
    """
    import scipy.sparse as sp

    ones = np.ones(limits.n_poses)
    poses = np.arange(limits.n_poses)
    at_site = sp.csr_array(
        (ones, (limits.site_index, poses)), shape=(limits.n_sites, limits.n_poses)
    )
    constraints = [at_site @ x <= limits.site_capacity, x.sum() >= 1.0]
    if limits.budget_units is not None:
        constraints.append(x.sum() <= limits.budget_units)
    if limits.site_cost_eur.any() or len(limits.rivals):
        constraints.append(x <= o[limits.site_index])
    if limits.budget_eur is not None:
        # Prices of the order of 1.
        unit = max(limits.budget_eur, 1.0)
        total = (limits.unit_cost_eur / unit) @ x + (limits.site_cost_eur / unit) @ o
        constraints.append(total <= (limits.budget_eur + COST_TOLERANCE_EUR) / unit)
    if limits.is_forced.any():
        constraints.append(x[np.flatnonzero(limits.is_forced)] == 1.0)
    if limits.is_forbidden.any():
        constraints.append(x[np.flatnonzero(limits.is_forbidden)] == 0.0)
    if limits.is_forced_site.any():
        constraints.append(at_site[np.flatnonzero(limits.is_forced_site)] @ x >= 1.0)
    if len(limits.rivals):
        constraints.append(o[limits.rivals[:, 0]] + o[limits.rivals[:, 1]] <= 1.0)
    return constraints


def window_constraints(
    x: cp.Variable,
    y: cp.Variable,
    z: cp.Variable,
    a: cp.Variable,
    reduced: ReducedProblem,
) -> list[cp.Constraint]:
    """Frames, windows and chains.

    y_f <= sum of V[c, f] x_c; z_w <= y_f for each f in w; a_k <= a_{k-1} + z_w(k): the
    sum of the z up to link k, written link by link.
    """
    import scipy.sparse as sp

    detected = sp.csr_array(reduced.detected().T).astype(np.float64)
    needs_frames = [z <= y[frames] for frames in reduced.window_frames.T]
    return [
        y <= detected @ x,
        *needs_frames,
        difference(reduced) @ a <= z[reduced.chains.window],
    ]


def tail_constraints(
    y: cp.Variable, a: cp.Variable, reduced: ReducedProblem
) -> list[cp.Constraint]:
    """Tails: a_{n-1} <= y_t where the first n windows need tail t, and a_k <= a_{k+1}.

    If t is not seen, a is 0 at all links of these windows, and none of them makes it 1
    later. Otherwise a is not less where it is allowed to grow: it says "up to link k"
    already.
    """
    chains = reduced.chains
    if not len(chains.tail_frame):
        return []
    n_tails = np.diff(chains.tail_start)
    last = np.repeat(chains.start[:-1], n_tails) + chains.tail_links - 1
    links = np.arange(len(chains.window))
    has_tails = np.repeat(n_tails > 0, np.diff(chains.start))
    earlier = np.setdiff1d(links[has_tails], chains.start[1:] - 1)
    return [a[last] <= y[chains.tail_frame], a[earlier] <= a[earlier + 1]]


def stabbing_constraints(
    x: cp.Variable, a: cp.Variable, reduced: ReducedProblem
) -> list[cp.Constraint]:
    """Stabbing: a_k <= sum of x over the poses that see one of some frames.

    These frames *stab* the windows up to link k: each window has one of them.
    Implied for whole x, but far stronger than the rows above for fractional x: with
    windows of one frame this is the MCLP's own row. The sum grows along the chain,
    so that it is written link by link with a variable u_k of its own. Each phase
    stabs the first window at another frame.
    """
    import cvxpy as cp

    constraints = []
    for phase in range(reduced.window_frames.shape[1]):
        u = cp.Variable(a.size, nonneg=True)
        enters = entering_poses(reduced, phase)
        constraints += [difference(reduced) @ u == enters @ x, a <= u]
    return constraints


def difference(reduced: ReducedProblem) -> sp.csr_array:
    """a_k - a_{k-1} along every chain, (n_links, n_links)."""
    import scipy.sparse as sp

    n_links = len(reduced.chains.window)
    is_later = ~np.isin(np.arange(1, n_links), reduced.chains.start)
    return sp.diags_array(
        [np.ones(n_links), -is_later.astype(np.float64)], offsets=[0, -1], format="csr"
    )


def requirement_constraints(
    a: cp.Variable, reduced: ReducedProblem, requirement: Requirement
) -> list[cp.Constraint]:
    """Requirements, as far as they can be stated in a: failures are left to cuts.

    Parameters
    ----------
    a : cvxpy.Variable, (n_links,)
        Links up to which a window is live.
    reduced : ReducedProblem
        Runs and chains.
    requirement : Requirement
        What must be reached.
    """
    weight = requirement.measure.weight
    if requirement.sums_margins:
        row = link_weights(reduced, margin_rows(reduced))
        unit = max(float(row.sum()), TOLERANCE)
        least = requirement.least / unit - constants.HELD_SLACK * TOLERANCE
        return [(row / unit) @ a >= least]
    link = last_links(reduced, min_margin_s=requirement.min_margin_s)
    can = (link >= 0) & (weight > 0.0)
    if requirement.needs_all and weight[can].sum() >= requirement.least - TOLERANCE:
        # No sum of weights, no rounding.
        return [a[np.unique(link[can])] == 1.0]
    if requirement.measure.is_mean and can.any():
        unit = float(weight.mean())
        least = requirement.least / unit - constants.HELD_SLACK
        return [(weight[can] / unit) @ a[link[can]] >= least]
    share, constraints = _tail_share(a, requirement.measure, link)
    least = requirement.least - constants.HELD_SLACK * TOLERANCE
    return [*constraints, share >= least]


def _tail_share(
    a: cp.Variable, measure: Measure, link: IntArray
) -> tuple[cp.Expression, list[cp.Constraint]]:
    """Mean over the worst share of samples, to be maximised, and its constraints.

    The largest eta - sum of p_s d_s / tail with d_s >= eta - APR_s, d_s >= 0 [1]_.
    `link`, (n_runs,), is the last link of each run, -1 if nothing avoids it.

    References
    ----------
    .. [1] R. T. Rockafellar, S. Uryasev, "Optimization of conditional
       value-at-risk", 2000.
    """
    import cvxpy as cp
    import scipy.sparse as sp

    can = link >= 0
    n_samples = len(measure.sample_weight)
    # APR of each sample, as weights of a.
    sample = measure.sample_index[can]
    share_of_sample = measure.weight[can] / measure.sample_weight[sample]
    by_sample = sp.csr_array(
        (share_of_sample, (sample, link[can])), shape=(n_samples, a.size)
    )
    eta = cp.Variable(bounds=[0.0, 1.0])
    d = cp.Variable(n_samples, nonneg=True)
    share = eta - (measure.sample_weight / measure.tail) @ d
    return share, [d >= eta - by_sample @ a]


def cut_constraints(
    x: cp.Variable, cuts: Sequence[Cut], limits: Limits
) -> list[cp.Constraint]:
    """Cuts: sum of the x that count >= units needed.

    Where sites fail, sites count: sum over them of v_s >= sites needed, with v_s <= 1
    and v_s <= sum of the x at the site that count.
    """
    import scipy.sparse as sp

    needed = np.array([cut.n_units for cut in cuts])
    is_counted = np.array([cut.is_counted for cut in cuts])
    if limits.failing == "unit":
        return [sp.csr_array(is_counted.astype(np.float64)) @ x >= needed]
    import cvxpy as cp

    # A variable for each site that counts in a cut.
    row, pose = np.nonzero(is_counted)
    site_of_cut = row * limits.n_sites + limits.site_index[pose]
    place, index = np.unique(site_of_cut, return_inverse=True)
    v = cp.Variable(len(place), bounds=[0.0, 1.0])
    at_site = sp.csr_array(
        (np.ones(len(row)), (index, pose)), shape=(len(place), x.size)
    )
    by_cut = sp.csr_array(
        (np.ones(len(place)), (place // limits.n_sites, np.arange(len(place)))),
        shape=(len(cuts), len(place)),
    )
    return [v <= at_site @ x, by_cut @ v >= needed]


def last_links(reduced: ReducedProblem, *, min_margin_s: float = -np.inf) -> IntArray:
    """Last link of every run's chain that leaves at least a margin, (n_runs,).

    -1 if none does.
    """
    margin_s = reduced.margin_s
    in_time = (margin_s > -np.inf) & (margin_s >= min_margin_s - TOLERANCE)
    n_links = in_time.sum(axis=1)
    first = reduced.chains.start[reduced.run_chain]
    return np.where(n_links > 0, first + n_links - 1, -1)


def link_weights(reduced: ReducedProblem, rows: Rows) -> FloatArray:
    """Sum of the weights of rows that are covered, as weights of a, (n_links,).

    A row is covered if a is 1 at its last link: with the rows of runs that is the APR,
    with those of margins the sum of weights times margins.
    """
    weights = np.zeros(len(reduced.chains.window))
    link = reduced.chains.start[rows.chain] + rows.last - 1
    np.add.at(weights, link, rows.weight)
    return weights


def solve_window_model(
    reduced: ReducedProblem,
    objective: Objective | None,
    *,
    requirements: Sequence[Requirement] = (),
    cuts: Sequence[Cut] = (),
    time_limit_s: float,
) -> MilpResult:
    """Best set of poses by one objective, as far as the time goes.

    Parameters
    ----------
    reduced : ReducedProblem
        The problem.
    objective : Objective, optional
        UNITS, COST, APR or MEAN_MARGIN; None: any set that meets the requirements.
        For ``MEAN_MARGIN`` the sum of weights times margins is maximised: at a
        given APR that is the same.
    requirements : sequence of Requirement
        What must be reached, but for failures.
    cuts : sequence of Cut
        What must hold after failures.
    time_limit_s : float
        Where stating the model and compiling it, which takes longer, would take
        half of it, nothing is found. [s]

    Returns
    -------
    result : MilpResult
        The set, and a bound in the objective's own unit.
    """
    import cvxpy as cp

    begun_s = now_s()
    limits = reduced.limits
    x = cp.Variable(reduced.n_poses, boolean=True)
    o = cp.Variable(limits.n_sites, bounds=[0.0, 1.0])
    constraints = limit_constraints(x, o, limits)
    goal = cp.Constant(0.0)
    unit = 1.0
    if objective is Objective.UNITS:
        goal = -x.sum()
    elif objective is Objective.COST:
        mean_eur = limits.unit_cost_eur.mean() + limits.site_cost_eur.mean()
        unit = max(float(mean_eur), TOLERANCE)
        goal = -((limits.unit_cost_eur / unit) @ x + (limits.site_cost_eur / unit) @ o)
        constraints.append(x <= o[limits.site_index])
    if len(reduced.chains.window):
        y = cp.Variable(reduced.n_frames, bounds=[0.0, 1.0])
        z = cp.Variable(len(reduced.window_frames), bounds=[0.0, 1.0])
        a = cp.Variable(len(reduced.chains.window), bounds=[0.0, 1.0])
        constraints += [
            *window_constraints(x, y, z, a, reduced),
            *tail_constraints(y, a, reduced),
            *stabbing_constraints(x, a, reduced),
        ]
        for requirement in requirements:
            constraints += requirement_constraints(a, reduced, requirement)
        if objective is Objective.APR and not reduced.measure.is_mean:
            goal, more = _tail_share(a, reduced.measure, last_links(reduced))
            constraints += more
        elif objective in (Objective.APR, Objective.MEAN_MARGIN):
            if objective is Objective.APR:
                rows = run_rows(reduced)
            else:
                rows = margin_rows(reduced)
            weights = link_weights(reduced, rows)
            unit = max(float(weights.sum()), TOLERANCE) / constants.SOLVER_SUM
            goal = (weights / unit) @ a
    if cuts:
        constraints += cut_constraints(x, cuts, limits)
    problem = cp.Problem(cp.Maximize(goal), constraints)
    if objective is not None and objective.is_minimised:
        sign = -1.0
    else:
        sign = 1.0
    spent_s = now_s() - begun_s
    if (1.0 + constants.COMPILED_TO_STATED) * spent_s > constants.TIME_SHARES[
        "model stated"
    ] * time_limit_s:
        return MilpResult(units=None, bound=sign * np.inf, is_finished=False)
    answer = run_solver(problem, time_limit_s=time_limit_s - spent_s)
    return MilpResult(
        units=np.flatnonzero(x.value > 0.5) if answer.is_found else None,
        bound=sign * answer.bound * unit,
        is_finished=answer.is_finished,
    )


def entering_poses(reduced: ReducedProblem, phase: int) -> sp.csr_array:
    """Poses that see a stabbing frame at a link, for the first time in its chain.

    Returns a sparse (n_links, n_poses) array of ones. In `phase`, 0 .. n_frames of
    a window - 1, the first window of a chain is stabbed at another frame.
    """
    import scipy.sparse as sp

    detected = reduced.detected()
    n_links = len(reduced.chains.window)
    links = []
    poses = []
    for chain in range(reduced.n_chains):
        start = reduced.chains.start[chain]
        windows = reduced.window_frames[reduced.chain(chain)]
        # The frame that is used longest stabs most windows to come.
        last_use = {frame: link for link, row in enumerate(windows) for frame in row}
        stabbing: set[int] = set()
        is_in = np.zeros(reduced.n_poses, dtype=bool)
        for link, row in enumerate(windows):
            if stabbing.isdisjoint(row):
                latest = sorted(row, key=lambda frame: -last_use[frame])
                if link == 0:
                    frame = latest[phase]
                else:
                    frame = latest[0]
                stabbing.add(frame)
                entering = np.flatnonzero(detected[:, frame] & ~is_in)
                is_in[entering] = True
                poses.append(entering)
                links.append(np.full(len(entering), start + link))
    none = np.empty(0, dtype=np.int64)
    columns = np.concatenate([none, *poses])
    rows = np.concatenate([none, *links])
    ones = np.ones(len(rows))
    return sp.csr_array((ones, (rows, columns)), shape=(n_links, reduced.n_poses))


# ---------- cuts: failures, which no row of the model speaks of
Fails = Callable[[WordArray], BoolArray]


def first_cuts(reduced: ReducedProblem, requirement: Requirement) -> list[Cut]:
    """Cuts that hold from the start: of every run, enough units must see enough.

    They must see stabbing frames, and tails that all windows of the run need. Such
    cuts are known only where no run may be lost whichever units fail.
    """
    if not (requirement.needs_all and requirement.n_failures):
        return []
    links = last_links(reduced, min_margin_s=requirement.min_margin_s)
    last = np.unique(links[(links >= 0) & (requirement.measure.weight > 0.0)])
    chains = np.searchsorted(reduced.chains.start, last, "right") - 1
    counted = []
    detected = reduced.detected()
    for chain, link in zip(chains, last - reduced.chains.start[chains], strict=True):
        frames, n_links = reduced.tails(int(chain))
        counted += list(detected[:, frames[n_links > link]].T)
    for phase in range(reduced.window_frames.shape[1]):
        enters = entering_poses(reduced, phase).toarray() > 0.0
        for start, link in zip(reduced.chains.start[chains], last, strict=True):
            counted.append(np.logical_or.reduce(enters[start : link + 1], axis=0))
    # What all poses see, the VUT may see when all of them have failed.
    has_base = bool(reduced.base.any())
    n_units = requirement.n_failures + 1
    cuts = []
    for is_counted in counted:
        if has_base and is_counted.all():
            continue
        cuts.append(Cut(is_counted=is_counted, n_units=n_units))
    return cuts


def violated_cuts(
    reduced: ReducedProblem, units: IntArray, requirement: Requirement
) -> list[Cut]:
    """Cuts that a set of poses, (n,), violates; none only if it meets a requirement."""
    cuts = []
    fails = _fails(reduced, requirement)
    n_units = requirement.n_failures + 1
    # What fails at once: each unit, or those at a site.
    if reduced.limits.failing == "unit":
        at = np.arange(len(units))
    else:
        at = reduced.limits.site_index[units]
    groups = np.unique(at)
    n_left = max(len(groups) - requirement.n_failures, 0)
    for left in combinations(groups.tolist(), n_left):
        union = unions_of(reduced, units[np.isin(at, left)][None, :])[0]
        if not fails(union[None, :])[0]:
            continue
        # Where no run may be lost, a cut for each lost run says more than one for all.
        each = [fails]
        if requirement.needs_all:
            runs = _lost_runs(reduced, union, requirement)
            each = [_fails(reduced, requirement, run) for run in runs]
        cuts += [_cut(reduced, union, one, n_units=n_units) for one in each]
    return cuts


def _lost_runs(
    reduced: ReducedProblem, union: WordArray, requirement: Requirement
) -> list[int]:
    """Of every chain, the lost run with the fewest windows: the hardest to avoid."""
    margin = union_margins_s(reduced, union[None, :])[0]
    is_lost = ~requirement.counts_run(margin) & (requirement.measure.weight > 0.0)
    last = last_links(reduced, min_margin_s=requirement.min_margin_s)
    runs = np.flatnonzero(is_lost)[np.argsort(last[is_lost], kind="stable")]
    _, first = np.unique(reduced.run_chain[runs], return_index=True)
    return list(runs[first].tolist())


def _fails(
    reduced: ReducedProblem, requirement: Requirement, run: int | None = None
) -> Fails:
    """A test of unions that fail a requirement, or do not avoid a run as it asks."""

    def fails(unions: WordArray) -> BoolArray:
        margin_s = union_margins_s(reduced, unions)
        if run is not None:
            return ~requirement.counts_run(margin_s[:, run])
        return requirement.reached(margin_s) < requirement.least - TOLERANCE

    return fails


def _cut(
    reduced: ReducedProblem, union: WordArray, fails: Fails, *, n_units: int
) -> Cut:
    """Cut from a set that fails, enlarged until every further pose would end that.

    `union`, (n_words,), is what the set sees.
    """
    words = reduced.words
    waiting = np.flatnonzero((words & ~union).any(axis=1))
    while len(waiting) > 0:
        waiting = waiting[fails(union | words[waiting])]
        # Those that add least come first: more of them fit in.
        n_new = np.bitwise_count(words[waiting] & ~union).sum(axis=1, dtype=np.int64)
        waiting = waiting[np.argsort(n_new, kind="stable")]
        grown = np.bitwise_or.accumulate(words[waiting], axis=0) | union
        n_fit = int(fails(grown).sum())
        if n_fit > 0:
            union = grown[n_fit - 1]
        waiting = waiting[n_fit:]
    return Cut(is_counted=((words & ~union) != 0).any(axis=1), n_units=n_units)
