"""Certificates: what was solved and found, and how good it is.

``certificate.json`` is the file's name. Next to it lies ``instance.npz``, the
whole problem (:mod:`.instances`): together they are enough to check the claim
without the optimiser.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct, defstruct, field

from geometry.errors import InputError, Unquoted
from geometry.opening import read_text
from geometry.tables import Text, read_table, take_text
from geometry.text_formats import load_data, parse_json
from geometry.writing import write_atomically

from ..detection_table import seeing_share
from ..layout import Certificate, Stage
from ..optimiser import PlacementProblem, PresolveStatistics
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


class StoredUnit(Struct, frozen=True, kw_only=True):
    """A unit of the layout."""

    # Of the detection table.
    row: _Count
    # Its name there.
    pose: Text
    # As ``layout.json`` has it.
    unit: dict[str, Any]


class Claim(Struct, frozen=True, kw_only=True):
    """What is claimed of a stage; see :class:`placement.layout.Stage`."""

    name: Text
    objective: float
    bound: float
    # None: infinite
    gap: float | None
    seconds: float
    # Is the layout claimed to be the best?
    is_proven: bool


class StoredCertificate(Struct, frozen=True, kw_only=True):
    """Claims of a ``certificate.json``, read and checked for form only.

    As :func:`build_certificate` makes them.
    """

    # What :func:`instance_of` says.
    instance: dict[str, Any]
    # What :func:`model_of` says, and the names of the "stages" in order.
    model: dict[str, Any]
    layout: Annotated[list[StoredUnit], _SOME]
    # Objectives in order.
    claims: Annotated[list[Claim], _SOME] = field(name="stages")
    # Is the layout claimed to be the best in all?
    is_proven: bool
    # Name and version of what the proof rests on.
    solver: Text
    # Of the programs that the numbers depend on.
    versions: dict[str, Any]
    presolve: _Sizes  # type: ignore[valid-type]  # sizes before and after

    @property
    def sha256(self) -> str:
        """Hash of the problem, see :func:`problem_hash`."""
        return str(self.instance["sha256"])

    @property
    def pose_index(self) -> tuple[int, ...]:
        """Rows of the detection table."""
        return tuple(one.row for one in self.layout)

    @property
    def stages(self) -> tuple[Stage, ...]:
        """Objectives in order, each with what is claimed of it."""
        return tuple(
            Stage(
                name=one.name,
                objective=one.objective,
                bound=one.bound,
                gap=math.inf if one.gap is None else one.gap,
                seconds=one.seconds,
            )
            for one in self.claims
        )

    @property
    def units(self) -> tuple[dict[str, Any], ...]:
        """The units, as ``layout.json`` has them."""
        return tuple(one.unit for one in self.layout)


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

    `units` are as the layout's file has them, and `pose_index` their rows of the table.
    `versions` says which programs the numbers depend on, `mounts` what the poses are.
    """
    # JSON has no infinity.
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
                "gap": (stage.gap if math.isfinite(stage.gap) else None),
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
    """Write ``certificate.json`` and ``instance.npz`` into a folder.

    `document` is that of :func:`build_certificate`. Raises OSError if the folder
    cannot be written to.
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
        The file cannot be read, is no certificate, or a field is missing or not of its
        kind.
    """
    where = str(path)
    # Form and version are checked; claims are not.
    document = parse_json(read_text(Path(path), "JSON"), where, "a certificate")
    if isinstance(document, dict):
        schema = document.get("schema")
    else:
        schema = Unquoted("no object")
    if schema != SCHEMA:
        raise InputError(f"{where}: schema", schema, SCHEMA)
    read = read_table(document, StoredCertificate, where)
    take_text(read.instance, "sha256", f"{where}: instance")
    return read


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
    """The model in words.

    It has fusion, what avoided means, and the formula of each stage.
    """
    words = load_data("placement", "certificate.toml")
    formulas = words["formulas"]
    if problem.limits.failing == "site":
        formulas |= words["site_formulas"]
    avoided = words["avoided"]["always"]
    if not is_never_lost(problem.rule):
        avoided += words["avoided"]["and_alive"]
    told = {"fusion": words["fusion"][problem.fusion], "avoided": avoided}
    if problem.seen_by_vut is not None:
        told["cars"] = words["parts"]["cars"]
    return told | {name: formulas[name] for name in stages}


def cars_of(problem: PlacementProblem) -> float:
    """Share of the VUTs that see in a problem, 0..1."""
    if problem.seen_by_vut is None:
        return 0.0
    return seeing_share(problem.table.axis)


def model_of(problem: PlacementProblem) -> dict[str, Any]:
    """Demands and limits of a problem, as plain values for JSON."""
    axis = problem.table.axis
    limits = problem.limits
    samples = problem.sample_index
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
                "n_runs": (
                    axis.n_runs
                    if floor.is_counted is None
                    else int(floor.is_counted.sum())
                ),
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
