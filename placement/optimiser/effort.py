"""How hard the optimiser tries."""

from dataclasses import dataclass
from typing import Literal

from geometry.errors import InputError

from .milp import DEFAULT_SOLVER

SolverName = Literal["auto", "exact", "relax", "greedy"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """How hard to try.

    Attributes
    ----------
    solver : {"auto", "exact", "relax", "greedy"}
        "greedy": search only, bounded by what all poses together reach; "relax": the bounds of
        relaxations, too; "exact": mixed-integer models and enumeration, too, until the time is up;
        "auto": the same, but relaxations alone where the instance is too large for models.
    time_limit_s : float
        For all stages together; presolve and the first layout are finished in any case. When it is
        up, the best layout found is kept and the gaps say what is not proven. [s]
    gap : float
        Relative gap at which a stage counts as settled.
    milp_solver : str
        Name of the mixed-integer solver in cvxpy.
    """

    solver: SolverName = "auto"
    time_limit_s: float = 60.0
    gap: float = 0.0
    milp_solver: str = DEFAULT_SOLVER

    def __post_init__(self) -> None:
        if self.solver not in ("auto", "exact", "relax", "greedy"):
            raise InputError("--solver", self.solver, "one of auto, exact, relax, greedy")
        if not self.time_limit_s > 0.0:
            raise InputError("--time-limit", self.time_limit_s, "seconds, more than 0")
        if not 0.0 <= self.gap < 1.0:
            raise InputError("--gap", self.gap, "a share, 0 <= gap < 1")
