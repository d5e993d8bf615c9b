"""``certificate.json``: what was solved, what was found, and how good it is said to be.

Next to it lies ``instance.npz``, the whole problem (:mod:`.instances`): together they are enough to
check the claim without the optimiser.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct, defstruct
from msgspec.structs import asdict as struct_asdict

from geometry.errors import InputError, Unquoted
from geometry.files import Text, parse_json, read_table, read_text, take_text, write_atomically

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

_Count = Annotated[int, Meta(ge=0)]
_SOME = Meta(min_length=1, description="a list of at least one")
_Sizes = defstruct(
    "_Sizes", [(one.name, tuple[_Count, _Count]) for one in fields(PresolveStatistics)]
)
"""Before and after presolve."""

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


class _Unit(Struct, frozen=True, kw_only=True):
    row: _Count
    pose: Text
    unit: dict[str, Any]


class _Stage(Struct, frozen=True, kw_only=True):
    name: Text
    objective: float
    bound: float
    gap: float | None
    seconds: float
    is_proven: bool


class _Document(Struct, frozen=True, kw_only=True):
    """A ``certificate.json``, as :func:`build_certificate` makes it."""

    instance: dict[str, Any]
    model: dict[str, Any]
    layout: Annotated[list[_Unit], _SOME]
    stages: Annotated[list[_Stage], _SOME]
    is_proven: bool
    solver: Text
    versions: dict[str, Any]
    presolve: _Sizes  # type: ignore[valid-type]


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

    `units` are as the layout's file has them, and `pose_index` their rows of the table. `versions`
    says which programs the numbers depend on, `mounts` what the poses are.
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
    """Write ``certificate.json``, a document of :func:`build_certificate`, and ``instance.npz``.

    Raises OSError if the folder cannot be written to.
    """
    save_problem(folder / INSTANCE_FILE, problem, mounts)
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_atomically(folder / CERTIFICATE_FILE, text)


def load_certificate(path: str | Path) -> StoredCertificate:
    """Read a ``certificate.json``; whether its claims are true is not looked at.

    Raises InputError: the file cannot be read, is no certificate, or a field is missing or not of
    its kind.
    """
    where = str(path)
    document = parse_json(read_text(Path(path), "JSON"), where, "a certificate")
    schema = document.get("schema") if isinstance(document, dict) else Unquoted("no object")
    if schema != SCHEMA:
        raise InputError(f"{where}: schema", schema, SCHEMA)
    read = read_table(document, _Document, where)
    stages = [
        Stage(
            name=one.name,
            objective=one.objective,
            bound=one.bound,
            gap=math.inf if one.gap is None else one.gap,
            seconds=one.seconds,
        )
        for one in read.stages
    ]
    return StoredCertificate(
        instance=read.instance,
        sha256=take_text(read.instance, "sha256", f"{where}: instance"),
        model=read.model,
        pose_index=tuple(one.row for one in read.layout),
        pose_ids=tuple(one.pose for one in read.layout),
        units=tuple(one.unit for one in read.layout),
        stages=tuple(stages),
        is_proven=tuple(one.is_proven for one in read.stages),
        all_proven=read.is_proven,
        solver=read.solver,
        versions=read.versions,
        presolve=struct_asdict(read.presolve),
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
