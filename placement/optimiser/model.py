"""The placement model, in the field's letters, one function per family of constraints.

x_c = 1: pose c is chosen. y_f: frame f is seen. z_w: window w is seen as a whole. a_k: one of the
windows of a chain up to its k-th link is seen; run r is avoided if a of its last link in time is
1. Only x has to be whole: given x, every y, z and a is bounded from above by zeros and ones
alone, and nothing bounds them from below but what we ask to be avoided, so that at the largest
values they can take they are zeros and ones themselves.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from geometry.arrays import BoolArray, FloatArray, IntArray

from .presolve import ReducedProblem
from .problem import TOLERANCE

if TYPE_CHECKING:  # it takes a second to import: done where a model is stated
    import cvxpy as cp

# Of the mean weight. What is held is relaxed by it, well above HiGHS's own 1e-6: asking for a sum
# to the last digit made it call feasible problems infeasible. Answers are checked exactly anyway.
_SLACK = 1.0e-3
_OBJECTIVE_SUM = 1.0e4  # HiGHS's tolerances are absolute, 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cut:
    """At least so many of some poses must be chosen.

    Attributes
    ----------
    is_counted : (n_poses,) bool
        Which poses count.
    n_units : int
        How many of them are needed.
    """

    is_counted: BoolArray
    n_units: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MilpResult:
    """What HiGHS says.

    Attributes
    ----------
    units : (n,) int or None
        Poses of the reduced problem; None if no feasible set was found.
    bound : float
        No feasible set has a higher objective; minus infinity if there is none.
    is_finished : bool
        Whether `units` are best (or there are none), rather than the best within the time.
    """

    units: IntArray | None
    bound: float
    is_finished: bool


def budget_constraint(x: cp.Variable, reduced: ReducedProblem) -> cp.Constraint:
    """Units: sum x <= K."""
    return x.sum() <= reduced.budget_units


def capacity_constraint(x: cp.Variable, reduced: ReducedProblem) -> cp.Constraint:
    """Sites: sum of the x of a site <= its capacity."""
    at_site = _incidence(reduced.site_index, len(reduced.site_capacity))
    return at_site @ x <= reduced.site_capacity


def seen_constraint(x: cp.Variable, y: cp.Variable, reduced: ReducedProblem) -> cp.Constraint:
    """Frames: y_f <= sum of V[c, f] x_c."""
    return y <= sp.csr_array(reduced.detected().T.astype(np.float64)) @ x


def window_constraints(
    y: cp.Variable, z: cp.Variable, reduced: ReducedProblem
) -> list[cp.Constraint]:
    """Windows: z_w <= y_f for each f in w."""
    return [z <= y[frames] for frames in reduced.window_frames.T]


def chain_constraint(z: cp.Variable, a: cp.Variable, reduced: ReducedProblem) -> cp.Constraint:
    """Chains: a_k <= a_{k-1} + z_w(k): the sum of the z up to link k, written link by link."""
    return difference(reduced) @ a <= z[reduced.chain_window]


def stabbing_constraints(
    x: cp.Variable, a: cp.Variable, reduced: ReducedProblem
) -> list[cp.Constraint]:
    """Stabbing: a_k <= sum of x over the poses that see one of the frames that stab all windows.

    Implied for whole x, but far stronger than the rows above for fractional x: with windows of one
    frame this is the MCLP's own row. The sum grows along the chain, so that it is written link by
    link with a variable u_k of its own. Each phase stabs the first window at another frame.
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
    n_links = len(reduced.chain_window)
    later = np.setdiff1d(np.arange(n_links), reduced.chain_start)
    links = np.arange(n_links)
    return sp.csr_array(
        (
            np.append(np.ones(n_links), -np.ones(len(later))),
            (np.append(links, later), np.append(links, later - 1)),
        ),
        shape=(n_links, n_links),
    )


def hold_constraints(
    a: cp.Variable, reduced: ReducedProblem, link: IntArray, *, share: float
) -> list[cp.Constraint]:
    """Runs of this share of the weight are avoided by the given links of their chains.

    Parameters
    ----------
    a : Variable
        Per link.
    reduced : ReducedProblem
        Runs and their weights.
    link : (n_runs,) int
        Last link that counts; -1 if none does.
    share : float
        Weight that must be avoided, at least.
    """
    can = link >= 0
    if abs(reduced.weight[can].sum() - share) < reduced.weight.min() / 2.0:
        # All that can be avoided must be: no sum of weights, no rounding.
        return [a[np.unique(link[can])] == 1.0]
    unit = float(reduced.weight.mean())
    return [(reduced.weight[can] / unit) @ a[link[can]] >= share / unit - _SLACK]


def cut_constraint(x: cp.Variable, cuts: Sequence[Cut]) -> cp.Constraint:
    """Cuts: sum of the x that count >= units needed."""
    counted = sp.csr_array(np.array([cut.is_counted for cut in cuts], dtype=np.float64))
    return counted @ x >= np.array([cut.n_units for cut in cuts])


def last_links(reduced: ReducedProblem, *, min_margin_s: float = -np.inf) -> IntArray:
    """Last link of every run's chain that leaves at least a margin, (n_runs,); -1 if none does."""
    in_time = (reduced.margin_s > -np.inf) & (reduced.margin_s >= min_margin_s - TOLERANCE)
    n_links = in_time.sum(axis=1)
    return np.where(n_links > 0, reduced.chain_start[reduced.run_chain] + n_links - 1, -1)


def avoided_weights(reduced: ReducedProblem) -> FloatArray:
    """Objective of the first stage: weight of avoided runs, as weights of a, (n_links,)."""
    weights = np.zeros(len(reduced.chain_window))
    np.add.at(weights, last_links(reduced), reduced.weight)
    return weights


def margin_weights(reduced: ReducedProblem) -> FloatArray:
    """Objective of the last stage: weight x margin, summed over avoided runs, as weights of a.

    A run whose first window seen is its k-th has all a from link k on: the margins' decrease from
    link to link, down to 0 after the last one in time, sums up to its margin.
    """
    weights = np.zeros(len(reduced.chain_window))
    for chain, margin, weight in zip(
        reduced.run_chain, reduced.margin_s, reduced.weight, strict=True
    ):
        in_time = margin[margin > -np.inf]
        start = reduced.chain_start[chain]
        weights[start : start + len(in_time)] -= weight * np.diff(in_time, append=0.0)
    return weights


def solve_milp(
    reduced: ReducedProblem,
    objective: FloatArray | None,
    *,
    hold_link: IntArray | None = None,
    hold_share: float = 0.0,
    cuts: Sequence[Cut] = (),
    time_limit_s: float,
) -> MilpResult:
    """Maximise a weighted sum of a, or only look for a feasible set.

    Parameters
    ----------
    reduced : ReducedProblem
        Presolved problem; at least one run.
    objective : (n_links,) float or None
        Weights of a; None: any feasible set will do.
    hold_link, hold_share
        See :func:`hold_constraints`; None: nothing is held.
    cuts : sequence of Cut
        Further constraints.
    time_limit_s : float
        For HiGHS. [s]
    """
    import cvxpy as cp

    x = cp.Variable(reduced.n_poses, boolean=True)
    y = cp.Variable(reduced.n_frames, bounds=[0.0, 1.0])
    z = cp.Variable(len(reduced.window_frames), bounds=[0.0, 1.0])
    a = cp.Variable(len(reduced.chain_window), bounds=[0.0, 1.0])
    constraints = [
        budget_constraint(x, reduced),
        capacity_constraint(x, reduced),
        seen_constraint(x, y, reduced),
        *window_constraints(y, z, reduced),
        chain_constraint(z, a, reduced),
        *stabbing_constraints(x, a, reduced),
    ]
    if hold_link is not None:
        constraints += hold_constraints(a, reduced, hold_link, share=hold_share)
    if cuts:
        constraints.append(cut_constraint(x, cuts))
    weights = np.zeros(a.size) if objective is None else objective
    unit = max(float(weights.sum()), TOLERANCE) / _OBJECTIVE_SUM
    problem = cp.Problem(cp.Maximize((weights / unit) @ a), constraints)
    with warnings.catch_warnings():
        # cvxpy calls a solution inaccurate when the time was up.
        warnings.filterwarnings("ignore", "Solution may be inaccurate")
        try:
            problem.solve(
                solver=cp.HIGHS,
                time_limit=max(time_limit_s, 0.0),
                mip_rel_gap=0.0,
                mip_abs_gap=0.0,
            )
        except cp.SolverError:  # nothing is known then, and nothing is lost
            return MilpResult(units=None, bound=np.inf, is_finished=False)
    if problem.status in (cp.INFEASIBLE, cp.settings.INFEASIBLE_OR_UNBOUNDED):  # all is bounded
        return MilpResult(units=None, bound=-np.inf, is_finished=True)
    info = problem.solver_stats.extra_stats
    is_found = info.primal_solution_status == 2  # kSolutionStatusFeasible
    return MilpResult(
        units=np.flatnonzero(x.value > 0.5) if is_found else None,
        # cvxpy minimises the negative.
        bound=-info.mip_dual_bound * unit,
        is_finished=problem.status == cp.OPTIMAL,
    )


def entering_poses(reduced: ReducedProblem, phase: int) -> sp.csr_array:
    """Which poses see, at a link for the first time in its chain, a stabbing frame."""
    detected = reduced.detected()
    n_links = len(reduced.chain_window)
    links, poses = [], []
    for chain in range(reduced.n_chains):
        start, windows = reduced.chain_start[chain], reduced.window_frames[reduced.chain(chain)]
        last_use = {frame: link for link, row in enumerate(windows) for frame in row}
        stabbing: set[int] = set()
        is_in = np.zeros(reduced.n_poses, dtype=bool)
        for link, row in enumerate(windows):
            if stabbing.isdisjoint(row):
                latest = sorted(row, key=lambda frame: -last_use[frame])
                frame = latest[phase] if link == 0 else latest[0]
                stabbing.add(frame)
                entering = np.flatnonzero(detected[:, frame] & ~is_in)
                is_in[entering] = True
                poses.append(entering)
                links.append(np.full(len(entering), start + link))
    columns = np.concatenate(poses) if poses else np.empty(0, dtype=np.int64)
    rows = np.concatenate(links) if links else np.empty(0, dtype=np.int64)
    return sp.csr_array((np.ones(len(rows)), (rows, columns)), shape=(n_links, reduced.n_poses))


def _incidence(group: IntArray, n_groups: int) -> sp.csr_array:
    """Which member belongs to which group, (n_groups, n_members)."""
    return sp.csr_array(
        (np.ones(len(group)), (group, np.arange(len(group)))), shape=(n_groups, len(group))
    )
