"""``certificate.json``: what was solved, what was found, and how good it is said to be.

Next to it lies ``instance.npz``, the whole problem (:mod:`.instances`): together they are enough to
check the claim without the optimiser, see :mod:`placement.verification.verify`.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from geometry.errors import InputError, Unquoted
from geometry.files import (
    parse_json,
    read_text,
    take,
    take_list,
    take_number,
    take_text,
    write_atomically,
)

from ..detection_table import has_levels, seeing_share
from ..layout import Certificate, Stage
from ..optimiser import PlacementProblem, PresolveStatistics
from ..optimiser.problem import Objective
from .instances import (
    INSTANCE_FILE,
    KIND,
    KIND_WITH_MOUNTS,
    Mounts,
    is_never_lost,
    problem_hash,
    save_problem,
)

_T = TypeVar("_T")
_Table = dict[str, Any]

SCHEMA = "place-rsus/certificate/1"
CERTIFICATE_FILE = "certificate.json"

_FORMULAS: dict[Objective, str] = {
    Objective.UNITS: "least sum_c x_c: the number of units",
    Objective.COST: "least sum_c price_c x_c + sum_s price_s u_s, u_s = 1 if site s carries a unit",
    Objective.APR_SURVIVED: "most of what is left of the APR when any `survive` of the units fail",
    Objective.APR: "most A(avoided): sum_r w_r a_r over the runs; with a tail, its mean over the "
    "worst share `tail` of the sampled worlds (conditional value at risk)",
    Objective.APR_ONE_FAILED: "most of min over the chosen c of the APR without c",
    Objective.SMALLEST_MARGIN: "largest min over the avoided runs with weight of last brake time - "
    "(confirmation + latency)",
    Objective.MEAN_MARGIN: "largest sum_r w_r a_r margin_r / sum_r w_r a_r",
}
_SITE_FORMULAS = {
    Objective.APR_SURVIVED: "most of what is left of the APR when any `survive` of the sites fail, "
    "each with all that it carries",
    Objective.APR_ONE_FAILED: "most of min over the sites of chosen c of the APR without what "
    "stands there",
}
_FUSIONS: Mapping[str, str] = {
    "any": "frame f is seen if a chosen pose detects in it: y_f <= sum_c V[c,f] x_c",
    "single": "one chosen pose must detect in all frames of the window by itself",
}
_AVOIDED = (
    "a_r = 1 if a window of n frames in a row of run r is seen and the time of its last frame "
    "+ latency <= last brake time of r"
)
_LEVELS = (
    "a run whose name ends in <v is a level of the run before that: a_r = 1 if that one is "
    "avoided, or the speed at contact stays below v km/h; its clock stands still from the last "
    "brake time of that run - latency on; w_r is what reaching it adds, so that the APR is a score"
)
_CARS = (
    "in every run the VUT's own sensors are one more unit, which costs nothing and never fails; "
    "seen_by_vut says in which frames it detects"
)
_ALIVE = (
    "; and if from then on until last brake time - latency no longer than track_memory_s passes "
    "without a frame that is seen"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StoredCertificate:
    """Claims of a ``certificate.json``, read and checked for form only."""

    instance: Mapping[str, Any]  # what :func:`instance_of` says
    sha256: str  # hash of the problem, see :func:`problem_hash`
    model: Mapping[str, Any]  # what :func:`model_of` says, and the names of the "stages" in order
    pose_index: tuple[int, ...]  # rows of the detection table
    pose_ids: tuple[str, ...]  # their names there
    units: tuple[Mapping[str, Any], ...]  # as ``layout.json`` has them
    stages: tuple[Stage, ...]  # objectives in order, each with what is claimed of it
    is_proven: tuple[bool, ...]  # whether each stage is claimed to be optimal
    all_proven: bool  # whether the layout is
    solver: str  # name and version of what the proof rests on
    versions: Mapping[str, Any]  # of the programs that the numbers depend on
    presolve: Mapping[str, tuple[int, int]]  # sizes before and after

    def __repr__(self) -> str:
        return f"StoredCertificate({list(self.pose_ids)}, {self.solver!r})"


def build_certificate(
    problem: PlacementProblem,
    certificate: Certificate,
    *,
    pose_index: Sequence[int],
    units: Sequence[Mapping[str, Any]],
    presolve: PresolveStatistics,
    seconds: Mapping[str, float],
    versions: Mapping[str, str],
    mounts: Mounts | None = None,
) -> dict[str, Any]:
    """The document that ``certificate.json`` holds; an infinite gap is None in it.

    `units` are the units as the layout's file has them, and `pose_index` their rows of the
    detection table in the same order. `seconds` says how long the steps took, `versions` which
    programs the numbers depend on, `mounts` what the poses are.
    """
    return {
        "schema": SCHEMA,
        "instance": instance_of(problem, mounts),
        "model": {
            **model_of(problem),
            "stages": [stage.name for stage in certificate.stages],
            "in_words": words_of(problem, [stage.name for stage in certificate.stages]),
        },
        "layout": [
            {"row": int(row), "pose": problem.table.pose_ids[row], "unit": dict(unit)}
            for row, unit in zip(pose_index, units, strict=True)
        ],
        "stages": [
            {
                **asdict(stage),
                "gap": stage.gap if math.isfinite(stage.gap) else None,  # JSON has no infinity
                "is_proven": bool(stage.gap == 0.0),
            }
            for stage in certificate.stages
        ],
        "is_proven": certificate.is_proven,
        "solver": certificate.solver,
        "presolve": {name: list(sizes) for name, sizes in asdict(presolve).items()},
        "seconds": dict(seconds),
        "versions": dict(versions),
    }


def save_certificate(
    folder: Path,
    document: Mapping[str, Any],
    problem: PlacementProblem,
    mounts: Mounts | None = None,
) -> None:
    """Write ``certificate.json`` and ``instance.npz`` into a folder that exists.

    `document` is that of :func:`build_certificate` with the same `mounts`. Raises OSError if the
    folder cannot be written to.
    """
    save_problem(folder / INSTANCE_FILE, problem, mounts)
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_atomically(folder / CERTIFICATE_FILE, text)


def load_certificate(path: str | Path) -> StoredCertificate:
    """Read a ``certificate.json``; whether its claims are true is not looked at.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    stored : StoredCertificate
        What it claims.

    Raises
    ------
    InputError
        The file cannot be read, is no certificate, or a field is missing or not of its kind.
    """
    path, where = Path(path), str(path)
    document = parse_json(read_text(path, "JSON"), where, "a certificate")
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        got = document.get("schema") if isinstance(document, dict) else Unquoted("no object")
        raise InputError(f"{where}: schema", got, SCHEMA)
    instance = _take_table(document, "instance", where)
    presolve = _take_table(document, "presolve", where)
    units = _take_objects(document, "layout", where)
    stages = _take_objects(document, "stages", where)
    return StoredCertificate(
        instance=instance,
        sha256=take_text(instance, "sha256", f"{where}: instance"),
        model=_take_table(document, "model", where),
        pose_index=tuple(_count(take(unit, "row", here), f"{here}.row") for here, unit in units),
        pose_ids=tuple(take_text(unit, "pose", here) for here, unit in units),
        units=tuple(_take_table(unit, "unit", here) for here, unit in units),
        stages=tuple(_read_stage(stage, here) for here, stage in stages),
        is_proven=tuple(_take_flag(stage, "is_proven", here) for here, stage in stages),
        all_proven=_take_flag(document, "is_proven", where),
        solver=take_text(document, "solver", where),
        versions=_take_table(document, "versions", where),
        presolve={
            field.name: _take_pair(presolve, field.name, f"{where}: presolve")
            for field in fields(PresolveStatistics)
        },
    )


def instance_of(problem: PlacementProblem, mounts: Mounts | None) -> dict[str, Any]:
    """Entry of a certificate about the instance file next to it."""
    return {
        "file": INSTANCE_FILE,
        "kind": KIND if mounts is None else KIND_WITH_MOUNTS,
        "sha256": problem_hash(problem, mounts),
        "n_poses": problem.table.n_poses,
        "n_sites": problem.limits.n_sites,
        "n_runs": problem.table.axis.n_runs,
        "n_frames": problem.table.axis.n_frames,
    }


def words_of(problem: PlacementProblem, stages: Sequence[str]) -> dict[str, str]:
    """The model in words: fusion, what avoided means, and the formula of each stage."""
    formulas = _FORMULAS if problem.limits.failing == "unit" else _FORMULAS | _SITE_FORMULAS
    return {
        "fusion": _FUSIONS[problem.fusion],
        "avoided": _AVOIDED + ("" if is_never_lost(problem.rule) else _ALIVE),
        **({"levels": _LEVELS} if has_levels(problem.table.axis) else {}),
        **({} if problem.seen_by_vut is None else {"cars": _CARS}),
        **{name: formulas[Objective(name)] for name in stages},
    }


def cars_of(problem: PlacementProblem) -> float:
    """Share of the VUTs that see in a problem, 0..1."""
    return 0.0 if problem.seen_by_vut is None else seeing_share(problem.table.axis)


def model_of(problem: PlacementProblem) -> dict[str, Any]:
    """Demands and limits of a problem, as plain values for JSON."""
    axis, limits, samples = problem.table.axis, problem.limits, problem.sample_index
    return {
        "fusion": problem.fusion,
        "goal": problem.goal,
        "survive": problem.survive,
        **({} if limits.failing == "unit" else {"failing": limits.failing}),
        "tail": problem.tail,
        **({} if problem.seen_by_vut is None else {"cars": cars_of(problem)}),
        "n_samples": 0 if samples is None else int(samples.max()) + 1,
        "limits": {
            "budget_units": limits.budget_units,
            "budget_eur": limits.budget_eur,
            "n_forced_units": int(limits.is_forced.sum()),
            "n_forbidden_units": int(limits.is_forbidden.sum()),
            "n_forced_sites": int(limits.is_forced_site.sum()),
            "n_rival_pairs": len(limits.rivals),
        },
        "floors": [
            {
                "name": floor.name,
                "apr": float(floor.share),
                "n_failures": floor.n_failures,
                "n_runs": axis.n_runs if floor.is_counted is None else int(floor.is_counted.sum()),
            }
            for floor in problem.floors
        ],
        "rule": {
            name: value
            for name, value in asdict(problem.rule).items()
            # Left out where it means nothing: JSON has no infinity.
            if name != "track_memory_s" or not is_never_lost(problem.rule)
        },
    }


def _take_one(table: Mapping[str, Any], key: str, where: str, kind: type[_T], expected: str) -> _T:
    value = take(table, key, where)
    if type(value) is not kind:
        raise InputError(f"{where}.{key}", value, expected)
    return value


def _take_table(table: Mapping[str, Any], key: str, where: str) -> dict[str, Any]:
    return _take_one(table, key, where, dict, "an object")


def _take_flag(table: Mapping[str, Any], key: str, where: str) -> bool:
    return _take_one(table, key, where, bool, "true or false")


def _take_objects(table: Mapping[str, Any], key: str, where: str) -> list[tuple[str, _Table]]:
    """Objects of a list that is not empty, and where each stands."""
    values = take_list(table, key, where)
    if not values:
        raise InputError(f"{where}.{key}", values, "at least one")
    objects = [(f"{where}.{key}[{index}]", value) for index, value in enumerate(values)]
    for here, value in objects:
        if not isinstance(value, dict):
            raise InputError(here, value, "an object")
    return objects


def _take_pair(table: Mapping[str, Any], key: str, where: str) -> tuple[int, int]:
    values = take_list(table, key, where)
    if len(values) != 2:
        raise InputError(f"{where}.{key}", values, "two numbers: before, after")
    return _count(values[0], f"{where}.{key}"), _count(values[1], f"{where}.{key}")


def _count(value: object, where: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise InputError(where, value, "a whole number, at least 0")
    return value


def _read_stage(table: Mapping[str, Any], where: str) -> Stage:
    has_gap = take(table, "gap", where) is not None
    return Stage(
        name=take_text(table, "name", where),
        objective=take_number(table, "objective", where),
        bound=take_number(table, "bound", where),
        gap=take_number(table, "gap", where) if has_gap else math.inf,
        seconds=take_number(table, "seconds", where),
    )
