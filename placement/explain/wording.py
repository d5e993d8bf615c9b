"""Conflicts in the words of the command line: one line that says what has to give way."""

from collections.abc import Sequence

import numpy as np

from geometry.errors import InputError, Unquoted
from geometry.scene import Scene

from ..candidates import CandidatePose
from ..optimiser import PlacementProblem
from ..optimiser.milp import DEFAULT_SOLVER
from ..wishes import Wishes, build_limits
from .conflicts import Conflict, find_conflicts
from .demands import Demand, Separation
from .relaxing import Relaxation

_MAX_NAMES = 4


def find_refusal(
    problem: PlacementProblem,
    wishes: Wishes,
    scene: Scene,
    candidates: Sequence[CandidatePose],
    *,
    time_limit_s: float = 30.0,
    milp_solver: str = DEFAULT_SOLVER,
) -> InputError | None:
    """Why wishes cannot be met, in one line.

    Parameters
    ----------
    problem : PlacementProblem
        What :func:`placement.wishes.build_problem` has made of them.
    wishes : Wishes
        What was asked.
    scene : Scene
        Its sites.
    candidates : sequence of CandidatePose
        Rows of the table.
    time_limit_s, milp_solver
        As for :func:`placement.explain.find_conflicts`.

    Returns
    -------
    refusal : InputError or None
        To be raised. None if they can be met, or it was not found out that they cannot.
    """
    separation = build_separation(problem, wishes, scene, candidates)
    conflicts = find_conflicts(
        problem,
        separation=separation,
        keeps_forced=True,
        time_limit_s=time_limit_s,
        milp_solver=milp_solver,
    )
    if not conflicts:
        return None
    words = _Words(problem, wishes, candidates)
    first, *others = conflicts
    got = "demands that no layout meets together"
    if len(first.demands) == 1:
        got = "more than any layout gives"
    more = [f"; besides, {words.demands(other)}: {words.ways_out(other)}" for other in others]
    return InputError(words.demands(first), Unquoted(got), words.ways_out(first) + "".join(more))


def build_separation(
    problem: PlacementProblem,
    wishes: Wishes,
    scene: Scene,
    candidates: Sequence[CandidatePose],
) -> Separation | None:
    """What a least distance between units has made of the limits; None where none is asked for."""
    if wishes.separation_m <= 0.0:
        return None
    limits = problem.limits
    free = build_limits(
        Wishes(
            budget_units=1,
            kept=wishes.kept,
            site_capacity=wishes.site_capacity,
        ),
        scene,
        candidates,
    )
    position_m = np.array([candidate.pose.position_m[:2] for candidate in candidates])
    where_m = np.array(
        [position_m[limits.site_index == site].mean(axis=0) for site in range(limits.n_sites)]
    )
    one, other = limits.rivals.T
    return Separation(
        distance_m=wishes.separation_m,
        pair_distance_m=np.linalg.norm(where_m[one] - where_m[other], axis=1),
        site_capacity=free.site_capacity,
    )


class _Words:
    """Demands as a user has written them."""

    def __init__(
        self, problem: PlacementProblem, wishes: Wishes, candidates: Sequence[CandidatePose]
    ) -> None:
        self.problem, self.wishes = problem, wishes
        self.site_ids = {
            int(site): candidate.site_id or candidate.id
            for site, candidate in zip(problem.limits.site_index, candidates, strict=True)
        }

    def demands(self, conflict: Conflict) -> str:
        """All demands of a conflict."""
        *first, last = [self._demand(demand) for demand in conflict.demands]
        return f"{', '.join(first)} and {last}" if first else last

    def ways_out(self, conflict: Conflict) -> str:
        """All relaxations of a conflict."""
        if not conflict.relaxations:
            return "fewer demands"
        ways = " or ".join(self._way_out(relaxation) for relaxation in conflict.relaxations)
        return ways if len(conflict.relaxations) == 1 else f"one of them to give way: {ways}"

    def _demand(self, demand: Demand) -> str:
        limits, kind = self.problem.limits, demand.kind
        if kind == "floor":
            assert demand.floor is not None
            floor = self.problem.floors[demand.floor]
            is_max = floor.name == "--target" and self.wishes.target == np.inf
            return _inserted(floor.name, "max" if is_max else f"{floor.share:g}")
        if kind == "forbidden":
            return f"--forbid-site {self._sites_of(np.flatnonzero(limits.is_forbidden).tolist())}"
        if kind == "forced_sites":
            sites = np.flatnonzero(limits.is_forced_site).tolist()
            return f"--force-site {_few([self.site_ids[site] for site in sites])}"
        if kind == "capacity" and self.wishes.site_capacity is None:
            return "what the sites can carry"
        number = {
            "survive": max((floor.n_failures for floor in self.problem.floors), default=0),
            "budget_units": (limits.budget_units or 0) - self._n_kept,
            "budget_eur": limits.budget_eur,
            "capacity": self.wishes.site_capacity,
            "separation": self.wishes.separation_m,
        }[kind]
        return f"{_OPTIONS[kind]} {number:g}"

    def _way_out(self, relaxation: Relaxation) -> str:
        demand, value = relaxation.demand, relaxation.value
        gone = list(relaxation.given_up)
        if demand.kind == "floor":
            assert demand.floor is not None
            name = self.problem.floors[demand.floor].name
            text = _inserted(name, f"{np.floor(value * 1.0e4 + 1.0e-6) / 1.0e4:g}")
        elif demand.kind == "forbidden":
            text = f"--forbid-site without {self._sites_of(gone)}"
        elif demand.kind == "forced_sites":
            text = f"--force-site without {_few([self.site_ids[site] for site in gone])}"
        elif demand.kind == "separation" and not value > 0.0:
            text = "no --separation"
        elif demand.kind == "budget_units":
            text = f"--budget {value - self._n_kept:g}"
        elif demand.kind == "budget_eur":
            text = f"--budget-cost {np.ceil(value * 100.0 - 1.0e-4) / 100.0:.2f}"
            text = text.removesuffix(".00")
        elif demand.kind == "separation":
            text = f"--separation {np.floor(value * 100.0) / 100.0:g}"
        else:
            text = f"{_OPTIONS[demand.kind]} {value:g}"
        if not relaxation.suffices:
            text += " (not enough by itself)"
        return text if relaxation.is_least else f"{text} (perhaps less will do)"

    @property
    def _n_kept(self) -> int:
        """Units that are kept aside from the budget."""
        return int(self.problem.limits.is_forced.sum())

    def _sites_of(self, poses: Sequence[int]) -> str:
        sites = self.problem.limits.site_index[list(poses)].tolist()
        return _few([self.site_ids[site] for site in sites])


_OPTIONS = {
    "survive": "--survive",
    "budget_units": "--budget",
    "budget_eur": "--budget-cost",
    "capacity": "--site-capacity",
    "separation": "--separation",
}


def _inserted(name: str, number: str) -> str:
    """A number after the first word of a name: "--min-case-apr 0.8 in CPNA-25"."""
    option, _, rest = name.partition(" ")
    return f"{option} {number} {rest}".rstrip()


def _few(names: Sequence[str]) -> str:
    """The first few names, each once."""
    each = list(dict.fromkeys(names))
    left = len(each) - _MAX_NAMES
    return ",".join(each[:_MAX_NAMES]) + (f" and {left} more" if left > 0 else "")
