"""The results of solving an instance from a file, and of verifying a certificate."""

from msgspec import UNSET, UnsetType

from .record import Record, StageRecord


class CoveringResult(Record, frozen=True, kw_only=True):
    """A covering instance solved; columns are numbered as in the file."""

    file: str
    problem: str
    budget: int | None
    budget_cost: float | None
    target: float | None
    objective: float
    bound: float
    gap: float
    chosen: tuple[int, ...]
    numbered_from: int
    chosen_names: tuple[str, ...] | None
    seconds: float
    is_proven: bool
    solver: str
    cost: float
    covered_weight: float
    coverable_weight: float
    total_weight: float
    columns: int
    rows: int


class PlacementSolution(Record, frozen=True, kw_only=True):
    """A placement problem solved, with its frames and windows."""

    file: str
    problem: str
    goal: str
    fusion: str
    objective: float
    bound: float
    gap: float
    chosen: tuple[int, ...]
    numbered_from: int
    chosen_names: tuple[str, ...]
    seconds: float
    is_proven: bool
    solver: str
    cost: float
    stages: tuple[StageRecord, ...]
    columns: int
    rows: int
    presolve_effect: str


class CheckRecord(Record, frozen=True, kw_only=True):
    """One check of a certificate, and what it found."""

    name: str
    passed: bool
    detail: str


class VerifiedStageRecord(Record, frozen=True, kw_only=True):
    """A stage of a certificate; the last three are UNSET where its proof was not looked at."""

    name: str
    objective: float
    bound: float
    gap: float
    claims_optimum: bool | UnsetType = UNSET
    is_proven_again: bool | UnsetType = UNSET
    reason: str | UnsetType = UNSET


class VerificationResult(Record, frozen=True, kw_only=True):
    """A folder of results, checked without the optimiser."""

    folder: str
    is_verified: bool
    checks: tuple[CheckRecord, ...]
    stages: tuple[VerifiedStageRecord, ...]
    solver: str
    not_checked: tuple[str, ...]
    seconds: dict[str, float]
