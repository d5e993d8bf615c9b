"""Independent check of a certificate.

Everything that can be recomputed is recomputed. That the layout is within all
limits, and what it is worth, is recomputed by :mod:`.recomputation`. That no
other is better than the bound is proven again where all poses together reach no
more, or all sets can be compared. Elsewhere the proof rests on the solver that
the certificate names; but layouts that differ in one unit are compared, if they
are not too many. Whether the detection table is right is the evaluator's
question.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from msgspec.structs import asdict

from ..candidates import CandidatePose
from ..layout import Stage
from ..optimiser.problem import Objective
from ..proof_files import Mounts, instance_of, model_of, problem_hash, words_of
from .certificates import StoredCertificate
from .instances import misnamed_pose, mount_differences
from .recomputation import (
    EPSILON,
    all_sets,
    best_others,
    floor_values,
    limit_checks,
    n_neighbours,
    n_sets_of_all,
    neighbours,
    simple_limits,
    stage_names,
    stage_values,
)

if TYPE_CHECKING:
    from ..optimiser import PlacementProblem

# So many sets of poses are compared at most.
MAX_SETS = 50_000
# Sets times frames; half a minute.
_MAX_LOOKS = 2_000_000_000
# Certificates round gaps.
_ROUNDED_GAP = 1.0e-9
_SIZES = ("poses", "frames", "windows", "runs")
# Relative; solvers meet their rows and whole numbers up to this.
_SOLVER_TOLERANCE = 1.0e-6


class Check(NamedTuple):
    """Something that was looked at.

    Attributes
    ----------
    name : str
        What.
    passed : bool
        Whether it is as it should be.
    detail : str
        In words.
    """

    name: str
    passed: bool
    detail: str


class StageProof(NamedTuple):
    """Grounds for a stage of a certificate.

    Attributes
    ----------
    name : str
        The stage.
    claims_optimum : bool
        Whether the certificate says that the layout is proven best in it.
    is_proven_again : bool
        Whether that was proven here, without a solver.
    reason : str
        How; or what it rests on instead.
    """

    name: str
    claims_optimum: bool
    is_proven_again: bool
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Verification:
    """Result of checking a certificate.

    Attributes
    ----------
    checks : tuple of Check
        In the order in which they were made.
    proofs : tuple of StageProof
        Of every stage; none if the layout could not be made out.
    """

    checks: tuple[Check, ...]
    proofs: tuple[StageProof, ...]

    @property
    def passed(self) -> bool:
        """True if everything that was looked at is as it should be."""
        return all(check.passed for check in self.checks)


def verify_certificate(
    problem: "PlacementProblem",
    stored: StoredCertificate,
    shown: Sequence[Mapping[str, Any]],
    *,
    mounts: Mounts | None = None,
    units: Sequence[CandidatePose] = (),
    max_sets: int = MAX_SETS,
    on_stage: Callable[[str], None] | None = None,
) -> Verification:
    """Check a certificate against the problem that it is about.

    Parameters
    ----------
    problem : PlacementProblem
        As it was saved.
    stored : StoredCertificate
        What is claimed.
    shown : sequence of mapping
        Units of the layout file beside it.
    mounts : Mounts, optional
        What the poses of the problem are, as the instance file says.
    units : sequence of CandidatePose
        Units of the layout file, with their sensors.
    max_sets : int
        Compare so many sets of poses at most.
    on_stage : callable, optional
        Called with what is done next.

    Returns
    -------
    verification : Verification
        Every check, also after one has failed, as far as it can be made.
    """
    report = on_stage or (lambda stage: None)
    report("recompute the layout's values")
    # Form first: instance, model, poses, layout file, mounts.
    checks = [
        *_instance_checks(problem, stored, mounts),
        *_model_checks(problem, stored),
    ]
    checks += [*_pose_checks(problem, stored), _layout_check(problem, stored, shown)]
    checks += _mount_checks(problem, stored, mounts, units)
    if not all(check.passed for check in checks if check.name in ("poses", "stages")):
        # There is nothing to recompute.
        return Verification(checks=tuple(checks), proofs=())
    chosen = np.array([stored.pose_index], dtype=np.int64)
    checks += [
        Check(
            name,
            bool(within[0]),
            "within the limit" if within[0] else "beyond the limit",
        )
        for name, within in limit_checks(problem, chosen).items()
    ]
    for floor in problem.floors:
        reached = float(floor_values(problem, floor, chosen)[0])
        who = f"{floor.n_failures} {problem.limits.failing}s"
        if floor.n_failures:
            failing = f" when any {who} fail"
        else:
            failing = ""
        text = f"{reached:.9g} is reached{failing}, {floor.share:.9g} is asked for"
        checks.append(
            Check(f"floor {floor.name}", reached >= floor.share - EPSILON, text)
        )
    # Each stage: its numbers, and whether a simple bound proves it.
    limits = simple_limits(problem, stored.stages)
    proofs = []
    for stage, claim in zip(stored.stages, stored.claims, strict=True):
        objective = Objective(stage.name)
        is_proven = claim.is_proven
        value = float(stage_values(problem, objective, chosen)[0])
        limit = limits[objective]
        checks += _stage_checks(stage, objective, is_proven, value, limit)
        is_simple = objective.excess(limit, stage.objective) <= objective.tolerance
        proofs.append(
            StageProof(
                stage.name,
                is_proven,
                is_proven and is_simple,
                (
                    f"{_limit_words(objective)} {limit:.9g}"
                    if is_simple
                    else stored.solver
                ),
            )
        )
    checks, proofs = _compare(problem, stored, checks, proofs, max_sets, report)
    return Verification(checks=tuple(checks), proofs=tuple(proofs))


def _check(name: str, wrong: Sequence[str], right: str) -> Check:
    """A check that fails with the first of what is wrong."""
    if wrong:
        return Check(name, False, wrong[0])
    return Check(name, True, right)


def _instance_checks(
    problem: "PlacementProblem", stored: StoredCertificate, mounts: Mounts | None
) -> list[Check]:
    """Checks that the certificate is about this instance."""
    found = problem_hash(problem, mounts)
    text = f"SHA-256 {found[:16]}.."
    if found != stored.sha256:
        other = [f"{text}, not {stored.sha256[:16]}.."]
    else:
        other = []
    wrong = [
        f"{name} {stored.instance.get(name)}, not {value}"
        for name, value in instance_of(problem, mounts).items()
        if name != "sha256" and stored.instance.get(name) != value
    ]
    as_said = "as the certificate says"
    return [_check("instance", other, text), _check("instance sizes", wrong, as_said)]


def _model_checks(
    problem: "PlacementProblem", stored: StoredCertificate
) -> list[Check]:
    """Checks that the certificate states the problem's model."""
    asked = model_of(problem)
    wrong = [name for name, value in asked.items() if stored.model.get(name) != value]
    names = [stage.name for stage in stored.stages]
    expected = [objective.value for objective in stage_names(problem)]
    is_so = names == expected and stored.model.get("stages") == expected
    table = problem.table
    axis = table.axis
    # Sizes before presolve follow from the problem.
    n_windows = np.maximum(
        np.diff(axis.run_start) + 1 - problem.rule.n_confirmations, 0
    ).sum()
    sizes = (table.n_poses, axis.n_frames, int(n_windows), axis.n_runs)
    presolve: dict[str, tuple[int, int]] = asdict(stored.presolve)
    before = tuple(pair[0] for pair in presolve.values())
    # Where a track must be held on to, presolve adds columns to those of the frames.
    shrinks = [a >= b for name, (a, b) in presolve.items() if name != "n_frames"]
    has_words = is_so and stored.model.get("in_words") == words_of(problem, names)
    if wrong:
        says = "another " + ", ".join(wrong)
    else:
        says = "what is asked"
    if stored.is_proven:
        proof = "complete"
    else:
        proof = "incomplete"
    is_said = stored.is_proven == all(claim.is_proven for claim in stored.claims)
    shown = ", ".join(f"{n} {noun}" for n, noun in zip(before, _SIZES, strict=True))
    return [
        Check(
            "model in words",
            has_words,
            "as asked" if has_words else "other words than this",
        ),
        Check("model", not wrong, f"the certificate says {says}"),
        Check("proof", is_said, f"claimed to be {proof}"),
        Check(
            "stages",
            is_so,
            ", ".join(names) + ("" if is_so else ": not those that are asked"),
        ),
        Check("presolve", before == sizes and all(shrinks), f"from {shown}"),
    ]


def _pose_checks(problem: "PlacementProblem", stored: StoredCertificate) -> list[Check]:
    """True if the poses exist; "poses" fails if nothing can be made of them."""
    table = problem.table
    rows = stored.pose_index
    missing = [row for row in rows if row >= table.n_poses]
    if missing or len(set(rows)) < len(rows):
        if missing:
            text = f"row {missing[0]} of {table.n_poses}"
        else:
            text = "a row twice"
        return [Check("poses", False, text)]
    wrong = [
        f"row {one.row} is {table.pose_ids[one.row]}, not {one.pose}"
        for one in stored.layout
        if table.pose_ids[one.row] != one.pose
    ]
    return [
        Check("poses", True, f"rows {', '.join(map(str, rows))} of {table.n_poses}"),
        _check("pose names", wrong, ", ".join(one.pose for one in stored.layout)),
    ]


def _layout_check(
    problem: "PlacementProblem",
    stored: StoredCertificate,
    shown: Sequence[Mapping[str, Any]],
) -> Check:
    """True if the layout file has the same units, and sites where the problem has."""
    if [dict(unit) for unit in shown] != [dict(unit) for unit in stored.units]:
        return Check("layout file", False, "it does not show the certificate's units")
    # Units share a site in the file if they share one in the problem.
    sites = [unit.get("site") for unit in shown]
    rows = stored.pose_index
    for (site, row), (other_site, other_row) in combinations(
        zip(sites, rows, strict=True), 2
    ):
        if not (site and other_site) or max(row, other_row) >= problem.table.n_poses:
            continue
        index = problem.limits.site_index
        if (site == other_site) != (index[row] == index[other_row]):
            return Check(
                "layout file", False, f"rows {row} and {other_row} stand on other sites"
            )
    return Check("layout file", True, f"it shows the same {len(shown)} units")


def _mount_checks(
    problem: "PlacementProblem",
    stored: StoredCertificate,
    mounts: Mounts | None,
    units: Sequence[CandidatePose],
) -> list[Check]:
    """Checks that units are mounted as the poses that were solved.

    Poses must be as their names say. Sites and prices of the problem follow from
    the poses, too.
    """
    if mounts is None:
        return []
    table = problem.table
    limits = problem.limits
    misnamed = misnamed_pose(mounts, table.pose_ids)
    # Poses of one site of the problem share a site of the scene.
    of_index: dict[int, str] = {}
    torn = [
        f"{table.pose_ids[row]} is elsewhere"
        for row, index in enumerate(limits.site_index.tolist())
        if of_index.setdefault(index, mounts.sites[row]) != mounts.sites[row]
    ]
    prices = np.array([sensor.price_eur for sensor in mounts.sensors])[
        mounts.sensor_index
    ]
    # Existing units may cost nothing.
    is_paid = (limits.unit_cost_eur == prices) | (
        (limits.unit_cost_eur == 0.0) & limits.is_forced
    )
    unpaid = [
        f"{table.pose_ids[row]} has another" for row in np.flatnonzero(~is_paid)[:1]
    ]
    are_named = "poses of the grid are and look as their names say"
    return [
        _check("poses and names", [misnamed] if misnamed else [], are_named),
        _check("poses and sites", torn, "they agree"),
        _check("prices of sensors", unpaid, "those of the models"),
        *(
            Check(
                f"unit {unit.id}",
                not wrong,
                wrong or f"is mounted, looks and is made as row {row}",
            )
            for unit, row in zip(units, stored.pose_index, strict=False)
            if row < table.n_poses
            for wrong in ["; ".join(mount_differences(mounts, row, unit))]
        ),
    ]


def _stage_checks(
    stage: Stage, objective: Objective, is_proven: bool, value: float, limit: float
) -> list[Check]:
    """Checks of a stage's claims, and of its numbers among themselves."""
    name = stage.name
    claimed = stage.objective
    bound = stage.bound
    distance = abs(bound - claimed)
    if distance <= EPSILON * max(1.0, abs(claimed)):
        gap = 0.0
    else:
        gap = math.inf
    if gap and claimed:
        gap = distance / abs(claimed)
    has_gap = gap == stage.gap or abs(gap - stage.gap) <= _ROUNDED_GAP * max(1.0, gap)
    fits = objective.excess(bound, claimed) >= -objective.tolerance
    if objective.is_minimised:
        side = "above"
    else:
        side = "below"
    return [
        Check(
            name,
            abs(value - claimed) <= objective.tolerance,
            f"recomputed {value:.9g}, claimed {claimed:.9g}",
        ),
        Check(
            f"{name}: bound",
            fits,
            f"{bound:.9g} is {'not ' if fits else ''}{side} the value",
        ),
        Check(
            f"{name}: gap",
            has_gap and is_proven == (stage.gap == 0.0),
            f"{stage.gap:.3g}, claimed {'proven' if is_proven else 'open'}",
        ),
        Check(
            f"{name}: reach",
            objective.excess(value, limit) <= objective.tolerance,
            f"{_limit_words(objective)} {limit:.9g}",
        ),
    ]


def _limit_words(objective: Objective) -> str:
    if objective.is_minimised:
        return "no layout has less than"
    return "no poses reach more than"


def _compare(
    problem: "PlacementProblem",
    stored: StoredCertificate,
    checks: list[Check],
    proofs: list[StageProof],
    max_sets: int,
    report: Callable[[str], None],
) -> tuple[list[Check], list[StageProof]]:
    """Look for a set of poses that a claimed bound does not allow for.

    All sets are compared, or those near the layout.
    """
    if all(proof.is_proven_again for proof in proofs):
        return checks, proofs
    # All sets if they are few, else the neighbours of the layout.
    most = min(max_sets, _MAX_LOOKS // problem.table.axis.n_frames)
    n_all = n_sets_of_all(problem)
    n_near = n_neighbours(problem, stored.pose_index)
    is_all = n_all <= most
    if is_all:
        report(f"compare all {n_all} sets of poses")
        families = all_sets(problem)
        words = f"all {n_all} sets of poses"
    elif n_near <= most:
        report(f"compare {n_near} sets that differ in one unit")
        families = neighbours(problem, stored.pose_index)
        words = f"{n_near} sets that differ in one unit"
    else:
        return checks, proofs
    best = best_others(problem, stored.stages, families)
    checks = checks.copy()
    proofs = proofs.copy()
    # A set beyond a bound disproves it.
    for index, (stage, other) in enumerate(zip(stored.stages, best, strict=True)):
        slack = _SOLVER_TOLERANCE * max(1.0, abs(stage.bound))
        excess = Objective(stage.name).excess(other.value, stage.bound)
        holds = not other.poses or excess <= slack
        text = f"none of {words} is better"
        if not holds:
            text = f"rows {', '.join(map(str, other.poses))} reach {other.value:.9g}"
        checks.append(Check(f"{stage.name}: others", holds, text))
        if is_all and proofs[index].claims_optimum:
            if holds:
                reason = f"{words} compared"
            else:
                reason = "disproved"
            proofs[index] = StageProof(stage.name, True, holds, reason)
    return checks, proofs
