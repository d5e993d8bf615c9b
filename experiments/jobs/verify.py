"""Verification of a folder of results without the optimiser.

The certificate is checked, and what it and the problem say is compared with every other
file that says it, too. What cannot be compared with anything is named.
"""

import csv
import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from msgspec import UNSET, UnsetType
from msgspec.structs import asdict

from geometry.arrays import BoolArray
from geometry.errors import InputError, Unquoted, located
from geometry.opening import read_bytes, read_text
from geometry.scene import Scene
from geometry.scene_sources import STUDY, load_scene
from geometry.study_scene import load_study_scene
from geometry.tables import read_table
from geometry.text_formats import parse_json
from placement.detection_table import plain_axis
from placement.evaluation import mix
from placement.layout import Layout, layout_records, load_layout
from placement.optimiser import Failing, Objective, PlacementProblem, PresolveStatistics
from placement.proof_files import (
    CERTIFICATE_FILE,
    INSTANCE_FILE,
    Mounts,
    cars_of,
    scene_hash,
)
from placement.question import Question, read_question
from placement.verification.certificates import StoredCertificate, load_certificate
from placement.verification.instances import load_stored_problem, misnamed_pose
from placement.verification.recomputation import stage_values
from placement.verification.verify import verify_certificate

from ..export.csv import to_csv
from ..export.geojson import to_geojson
from ..language import mark
from ..parts import bill_of_materials, certified
from ..parts.comparison import GREEDY
from ..parts.reading import StoredResult, check_schema, load_result
from ..progress import StageProgress
from ..results.folders import (
    APR_FILE,
    LAYOUT_FILE,
    MANIFEST,
    MARKER,
    RUNS_FILE,
    changed_files,
    read_manifest,
)
from ..results.record import Record, StageRecord, to_plain
from ..results.signatures import signature_fault
from ..results.tables import ALL, GROUP_COLUMNS, plain_cell
from .anew import agree, compare_anew

if TYPE_CHECKING:
    import pandas as pd

_TOLERANCE = 1.0e-9
_COMPARED = {
    LAYOUT_FILE,
    MARKER,
    RUNS_FILE,
    APR_FILE,
    "certificate.json",
    "instance.npz",
}
_CSV = "layout.csv"
_GEOJSON = "layout.geojson"
_EXPECTED = (_CSV, bill_of_materials.FILE_NAME, "report.html")
_HEADLINE = "headline"
_EVALUATED = ("place-rsus/evaluation/2", "place-rsus/comparison/2")
_MIXED = {_HEADLINE: ("rsu_all", "vut_and_rsus")}
"""Parties whose ratios are those of two others by the share of cars that see."""


class CheckRecord(Record, frozen=True, kw_only=True):
    """One check of a certificate, and what it found."""

    name: str
    passed: bool
    detail: str


class VerifiedStageRecord(Record, frozen=True, kw_only=True):
    """A stage of a certificate.

    The last three are UNSET where its proof was not looked at.
    """

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
    # The result was made anew, and every file compared.
    is_deep: bool
    # By the key that was given.
    is_signed: bool
    seconds: dict[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderChecks:
    """Comparisons that were made, and those that could not be."""

    checks: list[CheckRecord] = field(default_factory=list)
    not_checked: list[str] = field(default_factory=list)
    # The result is made anew afterwards, and every file compared.
    is_deep: bool = False

    def leave(self, what: str, *, deep: bool = False) -> None:
        """Something that is not checked here.

        Not said where ``--deep`` is on and checks it.
        """
        if not (deep and self.is_deep):
            self.not_checked.append(what)

    def add(self, name: str, wrong: str, right: str) -> None:
        """A check: what is wrong in words, or nothing.

        And what to say if all is right.
        """
        self.checks.append(
            CheckRecord(name=name, passed=not wrong, detail=wrong or right)
        )


def asked_question(folder: Path) -> Question | None:
    """The question that a result answers.

    None where its summary does not say, or is none.

    Raises InputError: the question in ``summary.json`` cannot be one.
    """
    path = folder / MARKER
    if not path.is_file():
        return None
    asked = _load_object(path).get("asked")
    if not isinstance(asked, dict) or not isinstance(asked.get("question"), dict):
        return None
    return read_question(asked["question"], f"{path}: asked")


def run_verification(
    folder: Path,
    *,
    scene: str = "",
    question: Question | None = None,
    key: Path | None = None,
    progress: StageProgress,
) -> VerificationResult:
    """Check a result folder.

    Certificate, instance and layout, and every other file.

    Parameters
    ----------
    folder : Path
        Of a placement, an evaluation, a comparison, a recording, or of ``certify``.
    scene : str
        Where the scene is; empty: the study's junction, if the folder says so.
    question : Question, optional
        What was asked, with its map imported: the result is made anew from it, and
        every file is compared with what is written then.
    key : Path, optional
        File with the public key that must have signed the folder.
    progress : StageProgress
        Is told the stages.

    Returns
    -------
    result : VerificationResult
        Every check, and what was not checked.

    Raises
    ------
    InputError
        A file is missing, damaged or no such file at all, or the result cannot be made
        anew.
    """
    if not folder.is_dir():
        raise InputError(str(folder), Unquoted("no folder"), "a folder with results")
    if not (folder / MANIFEST).exists():
        got = Unquoted(f"no {MANIFEST}")
        raise InputError(
            str(folder), got, "a folder of results, as place-rsus has written it"
        )
    progress(mark("read"), 0, 0)
    found = FolderChecks(is_deep=question is not None)
    is_signed = False
    if key is not None:
        fault = signature_fault(folder, folder / MANIFEST, key)
        is_signed = not fault
        found.add("signature", fault, f"{MANIFEST} is signed by {key.name}")
    if (folder / CERTIFICATE_FILE).exists():
        check = None
    else:
        check = _check_without_proof(folder)
    if check is not None:
        if question is not None:
            got = Unquoted(f"{folder}, which is no placement")
            raise InputError(
                "--deep", got, "a placement: run the command again, and compare"
            )
        check(folder, found)
        _leave_maker(key, found)
        return VerificationResult(
            folder=str(folder),
            is_verified=all(check.passed for check in found.checks),
            checks=tuple(found.checks),
            stages=(),
            solver="",
            not_checked=tuple(found.not_checked),
            is_deep=False,
            is_signed=is_signed,
            seconds=progress.finish(),
        )
    stored = load_certificate(folder / CERTIFICATE_FILE)
    problem, mounts = load_stored_problem(folder / INSTANCE_FILE)
    summary = _load_summary(folder / MARKER)
    layout = None
    if (folder / LAYOUT_FILE).exists() or summary is None or "recording" not in summary:
        layout = load_layout(folder / LAYOUT_FILE)
    # A recording's units have no poses: they stand in its summary alone.
    shown = _recorded_units(summary) if layout is None else layout_records(layout)
    proof = verify_certificate(
        problem,
        stored,
        shown,
        mounts=mounts,
        units=() if layout is None else layout.units,
        on_stage=lambda stage: progress(stage, 0, 0),
    )
    progress(mark("compare files"), 0, 0)
    found.leave(
        "whether the detection table is right: the evaluator's disagreement with it is"
        " in the report",
        deep=True,
    )
    for one in proof.proofs:
        if one.claims_optimum and one.reason == stored.solver:
            found.leave(
                f"that no layout is better in {one.name}: this rests on {stored.solver}"
            )
    known = _check_scene(scene, mounts, layout, problem.table.pose_ids, found)
    _check_files(folder, stored, problem, layout, summary, known, found)
    if question is not None:
        compare_anew(folder, question, found.add, progress)
        found.leave(
            "seconds, versions of programs, and whether the models of detection and"
            " braking are like the world"
        )
    _leave_maker(key, found)
    proofs = {one.name: one._asdict() for one in proof.proofs}
    return VerificationResult(
        folder=str(folder),
        is_verified=proof.passed and all(check.passed for check in found.checks),
        checks=(
            *(CheckRecord(**check._asdict()) for check in proof.checks),
            *found.checks,
        ),
        stages=tuple(
            VerifiedStageRecord(
                objective=stage.objective,
                bound=stage.bound,
                gap=stage.gap,
                **proofs.get(stage.name, {"name": stage.name}),
            )
            for stage in stored.stages
        ),
        solver=stored.solver,
        not_checked=tuple(found.not_checked),
        is_deep=question is not None,
        is_signed=is_signed,
        seconds=progress.finish(),
    )


def _leave_maker(key: Path | None, found: FolderChecks) -> None:
    """Say that nothing tells who made a folder, unless a key was given."""
    if key is None:
        found.leave(
            "who has made the folder: whoever changes files together with"
            f" {MANIFEST} and all that agrees with them is not found out; --key checks"
            " a signature"
        )


def _check_without_proof(folder: Path) -> Callable[[Path, FolderChecks], None] | None:
    """How a folder is checked that has no certificate.

    None if it should have one.
    """
    if (folder / certified.JSON_NAME).exists():
        return _check_certified
    if not (folder / MARKER).is_file():
        return None
    summary = _load_object(folder / MARKER)
    if summary.get("schema") in _EVALUATED:
        return _check_evaluated
    if "recording" in summary and summary.get("stages") is None:
        return _check_recorded
    return None


def _check_evaluated(folder: Path, found: FolderChecks) -> None:
    """A folder of ``evaluate`` or ``compare``.

    Ratios from the runs, and the layout's files.
    """
    names = _check_manifest(folder, found)
    result = load_result(folder)
    _check_ratios(result, found)
    compared = _check_exports(folder, result.layout, None, names, found)
    found.leave(
        f"detections, confirmations, margins and outcomes in {RUNS_FILE}, and all else"
        f" in {MARKER}"
    )
    others = names - compared - _COMPARED
    if others:
        found.leave(f"what {', '.join(sorted(others))} say")


def _check_recorded(folder: Path, found: FolderChecks) -> None:
    """A folder of a recording whose units were judged.

    There is nothing but a summary.
    """
    _check_manifest(folder, found)
    found.leave(f"what {MARKER} says: the recording is not at hand")


def _check_certified(folder: Path, found: FolderChecks) -> None:
    """A folder of ``certify``.

    Its numbers anew from bounds and APRs, and its layout's sites.
    """
    path = folder / certified.JSON_NAME
    stored = read_table(_load_object(path), certified.CertifiedResult, str(path))
    layout = load_layout(folder / LAYOUT_FILE)
    sites = tuple(unit.site_id for unit in layout.units)
    with located(f"{path}: "):
        numbers = certified.recompute(stored)
    found.add("numbers", "; ".join(numbers), "they agree")
    if sites == stored.units:
        elsewhere = ""
    else:
        elsewhere = "it shows units at other sites"
    found.add("layout file", elsewhere, "they agree")
    _check_manifest(folder, found)
    found.leave(
        "bounds of the blocks, and APRs by world: certify computes them again, with the"
        " seed"
    )


def _load_summary(path: Path) -> Mapping[str, Any] | None:
    """The summary as plain values; None if there is none."""
    if path.exists():
        summary = _load_object(path)
    else:
        summary = None
    if summary is not None and "recording" not in summary:
        check_schema(summary, str(path))
    return summary


def _load_object(path: Path) -> dict[str, Any]:
    document = parse_json(read_text(path, "JSON"), str(path), "a summary")
    if not isinstance(document, dict):
        raise InputError(str(path), Unquoted("no object"), "a summary")
    return document


def _recorded_units(summary: Mapping[str, Any] | None) -> list[Mapping[str, Any]]:
    """Units in a recording's summary; none if it is no such thing."""
    if summary is None:
        units = None
    else:
        units = summary.get("layout")
    if not isinstance(units, list) or not all(isinstance(unit, dict) for unit in units):
        return []
    return units


def _check_scene(
    source: str,
    mounts: Mounts | None,
    layout: Layout | None,
    pose_ids: tuple[str, ...],
    found: FolderChecks,
) -> Scene | None:
    """Compare the scene that is said with the one at hand.

    Returns it if it is the same one.
    """
    if mounts is None:
        if layout is not None:
            found.leave(
                "positions, directions and sensor models of the units, and the scene: "
                f"{INSTANCE_FILE} does not say what its poses are"
            )
        return None
    name = mounts.scene_name
    if layout is None:
        shown = ""
    else:
        shown = layout.scene_name
    if shown == name:
        wrong = ""
    else:
        wrong = f"{LAYOUT_FILE} says {shown or 'nothing'}, not {name}"
    found.add("scene", wrong, name)
    if not source and name != STUDY:
        found.leave(
            f"whether {name} is the scene that it is said to be: --scene tells where"
            " it is"
        )
        return None
    if source:
        scene = load_scene(source)
    else:
        scene = load_study_scene()
    # A map's scene is called after its file, which may have another name by now.
    scene = replace(scene, name=name)
    digest = scene_hash(scene)
    if digest != mounts.scene_sha256:
        text = (
            f"SHA-256 {digest[:16]}.., not {mounts.scene_sha256[:16]}..; it may have"
            " changed"
        )
        found.add(
            "scene as it stands", text if source else f"{text} with the version", ""
        )
        return None
    astray = misnamed_pose(
        mounts, pose_ids, {site.id: site.position_m for site in scene.sites}
    )
    found.add(
        "scene as it stands",
        astray,
        f"SHA-256 {digest[:16]}.., and poses are at its sites",
    )
    return scene


def _check_files(
    folder: Path,
    stored: StoredCertificate,
    problem: PlacementProblem,
    layout: Layout | None,
    summary: Mapping[str, Any] | None,
    scene: Scene | None,
    found: FolderChecks,
) -> None:
    """Compare all files of a folder with what they must agree with.

    A recording has no layout; the scene is None unless it is known to be the one.
    Raises InputError if ``SHA256SUMS`` is no such list, or a file cannot be read.
    """
    others = _check_manifest(folder, found)
    if summary is None:
        found.leave(f"what the optimisation said: there is no {MARKER}")
    else:
        _check_summary(summary, stored, problem, layout, found)
    if layout is not None:
        try:
            result = load_result(folder)
        except InputError as error:
            found.add("tables", str(error).replace(f"{folder}/", ""), "")
        else:
            _check_runs(result.runs, problem, found)
            _check_ratios(result, found)
        missing = [name for name in _EXPECTED if name not in others]
        if missing:
            found.leave(f"{', '.join(missing)}: not there", deep=True)
        others -= _check_exports(folder, layout, scene, others, found)
    others -= _COMPARED
    if others:
        found.leave(f"what {', '.join(sorted(others))} say", deep=True)


def _check_manifest(folder: Path, found: FolderChecks) -> set[str]:
    """Every file against its hash.

    Returns the names of the files that are there.
    """
    listed = read_manifest(folder)
    changes = changed_files(folder)
    if not changes:
        found.add("files", "", f"{len(listed)} files, each as {MANIFEST} lists it")
    else:
        for name, change in changes.items():
            found.add(f"file {name}", f"{change}, says {MANIFEST}", "")
    return {name for name in {*listed, *changes} if changes.get(name) != "missing"}


def _check_summary(
    summary: Mapping[str, Any],
    stored: StoredCertificate,
    problem: PlacementProblem,
    layout: Layout | None,
    found: FolderChecks,
) -> None:
    """Compare the summary with certificate, problem and layout."""
    values = {stage.name: stage for stage in stored.stages}
    samples = problem.sample_index
    if samples is None:
        n_samples = 1
    else:
        n_samples = int(samples.max()) + 1
    expected: dict[str, Any] = {
        "layout": [dict(unit) for unit in stored.units],
        "fusion": problem.fusion,
        "candidates": problem.table.n_poses,
        "solver": stored.solver,
        "versions": dict(stored.versions),
        "stages": [
            {name: getattr(stage, name) for name in StageRecord.__struct_fields__}
            for stage in stored.stages
        ],
    }
    if layout is not None:
        expected |= {
            "name": layout.name,
            "goal": problem.goal,
            "cars": cars_of(problem),
            "budget": problem.limits.budget_units,
            "runs": plain_axis(problem.table.axis).n_runs // n_samples,
            "cost_eur": sum(unit.sensor.price_eur for unit in layout.units),
            "presolve": str(PresolveStatistics(**asdict(stored.presolve))),
        }
    for stage, what, key in (
        *(
            ("apr", "objective", "apr"),
            ("apr", "bound", "bound"),
            ("apr", "gap", "gap"),
        ),
        ("cost_eur", "objective", "spent_eur"),
    ):
        if stage in values and summary.get(key) is not None:
            expected[key] = getattr(values[stage], what)
    chosen = np.array([stored.pose_index])
    for failing in get_args(Failing):
        key = f"apr_without_worst_{failing}"
        asked = replace(problem, limits=replace(problem.limits, failing=failing))
        if "apr" in values and summary.get(key) is not None:
            (left,) = stage_values(asked, Objective.APR_ONE_FAILED, chosen)
            expected[key] = float(left)
    # What a summary tells of units beyond the layout file, such as where they are in
    # words.
    keys = [set(unit) for unit in stored.units]
    # Older summaries are of blind cars.
    told = {"cars": 0.0} | dict(summary)
    if isinstance(told.get("layout"), list) and len(told["layout"]) == len(keys):
        told["layout"] = [
            (
                {key: unit[key] for key in unit if key in known}
                if isinstance(unit, dict)
                else unit
            )
            for unit, known in zip(told["layout"], keys, strict=True)
        ]
    wrong = [key for key, value in expected.items() if not agree(told.get(key), value)]
    for key in wrong:
        words = f"{summary.get(key, Unquoted('nothing'))}, not {expected[key]}"
        if isinstance(expected[key], list | dict):
            words = "another"
        found.add(f"{MARKER}: {key}", f"{words} as the certificate has it", "")
    if not wrong:
        found.add(MARKER, "", f"{', '.join(expected)}: as the certificate has them")
    found.leave(
        "solver, presolved sizes, versions of programs and seconds: certificate.json"
        f" and {MARKER} agree, but nothing else tells",
        deep=True,
    )
    if layout is not None:
        evaluated = {"evaluation", "baseline", "greedy", "schema"}
    else:
        evaluated = {"schema"}
    rest = [
        key for key in summary if key not in {*expected, *evaluated} and summary[key]
    ]
    if rest:
        found.leave(f"in {MARKER}: {', '.join(rest)}", deep=True)


def _check_runs(
    runs: "pd.DataFrame", problem: PlacementProblem, found: FolderChecks
) -> None:
    """Runs of the evaluator are those of the problem."""
    if problem.sample_index is not None:
        found.leave(
            f"runs in {RUNS_FILE}: the problem has those of sampled worlds", deep=True
        )
        return
    axis = plain_axis(problem.table.axis)
    row_of = {name: row for row, name in enumerate(axis.run_ids)}
    unknown = [name for name in runs["run"].unique() if name not in row_of]
    if unknown or len(row_of) != runs["run"].nunique():
        words = f"{unknown[0] if unknown else 'a run'} is not one of the problem's"
        found.add(RUNS_FILE, words, "")
        return
    rows = runs["run"].map(row_of).to_numpy()
    last_s = np.where(
        np.isfinite(axis.last_brake_time_s), axis.last_brake_time_s, np.nan
    )
    texts = {"case": axis.cases, "approach": axis.approaches}
    texts |= {"position": axis.positions, "weather": axis.weathers}
    numbers = {"vut_speed_kmh": axis.vut_speed_kmh, "weight": axis.weight}
    numbers |= {"last_brake_time_s": last_s}
    close = partial(np.allclose, rtol=0.0, atol=1e-12, equal_nan=True)
    wrong = [
        name
        for name in texts
        if (runs[name].to_numpy() != np.array(texts[name])[rows]).any()
    ]
    wrong += [
        name
        for name in numbers
        if not close(runs[name].to_numpy(dtype=float), numbers[name][rows])
    ]
    if wrong:
        text = f"another {', '.join(wrong)} than the problem has"
    else:
        text = ""
    found.add(
        RUNS_FILE, text, f"{axis.n_runs} runs and their weights, as in the problem"
    )
    found.leave(
        f"detections, confirmations, margins and outcomes in {RUNS_FILE}: `place-rsus"
        f" evaluate --layout {LAYOUT_FILE}` makes them anew",
        deep=True,
    )


def _check_ratios(result: StoredResult, found: FolderChecks) -> None:
    """Check that ratios follow from the outcomes of the runs.

    Those in ``apr.csv`` and in the summary.
    """
    outcomes = {
        key: _Outcomes.of(table)
        for key, table in result.runs.groupby(["layout", "party"], sort=False)
    }
    wrong = ""
    for row in result.apr.to_dict("records"):
        group = [str(row[name]) for name in GROUP_COLUMNS]
        ratio, n_runs, n_avoided = outcomes[row["layout"], row["party"]].in_group(group)
        if math.isnan(row["apr"]):
            got = None
        else:
            got = float(row["apr"])
        if not agree(got, ratio) or (n_runs, n_avoided) != (
            row["n_runs"],
            row["n_avoided"],
        ):
            words = ", ".join(
                [row["layout"], row["party"], *(one for one in group if one != ALL)]
            )
            wrong = f"{words}: {got}, not {ratio}"
            break
    found.add(APR_FILE, wrong, f"{len(result.apr)} ratios follow from {RUNS_FILE}")
    summary = to_plain(result.summary)
    layouts = [summary, *(summary.get("compared") or ()), summary.get("baseline")]
    told = {one["name"]: one["evaluation"] for one in layouts if one}
    if summary.get("greedy"):
        told[GREEDY] = summary["greedy"]["evaluation"]
    wrongs = [
        words
        for name, evaluation in told.items()
        for words in _wrong_ratios(name, evaluation, outcomes, summary["cars"])
    ]
    right = f"of {', '.join(told)}: they follow from {RUNS_FILE}"
    found.add(f"{MARKER}: ratios", wrongs[0] if wrongs else "", right)


def _wrong_ratios(
    name: str,
    evaluation: Mapping[str, Any],
    outcomes: Mapping[Any, "_Outcomes"],
    cars: float,
) -> Iterator[str]:
    """Ratios in a summary that do not follow from the runs, in words.

    Those of a layout's parties.
    """
    together = ("vut", "rsu_all", "vut_and_rsus", "vam", "all_sources", _HEADLINE)
    known = {key: evaluation[key] for key in together if evaluation.get(key)}
    for party, ratios in (known | evaluation["units"]).items():
        of_party = [outcomes.get((name, one)) for one in _MIXED.get(party, (party,))]
        if None in of_party:
            yield f"{name}, {party}: no runs of it in {RUNS_FILE}"
            continue
        groups = {("case", ALL): ratios["all"]}
        for key in ("case", "position"):
            told_by = ratios.get(f"by_{key}") or {}
            groups |= {(key, word): ratio for word, ratio in told_by.items()}
        for (key, word), ratio in groups.items():
            group = [word if column == key else ALL for column in GROUP_COLUMNS]
            expected, *seeing = (
                one.in_group(group)[0] for one in of_party if one is not None
            )
            if seeing and expected is not None and seeing[0] is not None:
                expected = mix(expected, seeing[0], cars)
            if not agree(ratio, expected):
                yield f"{name}, {party}, {word}: {ratio}, not {expected}"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Outcomes:
    """Runs of one party of one layout."""

    # By GROUP_COLUMNS: arrays of texts.
    words: tuple[Any, ...]
    weight: Any
    is_avoided: BoolArray

    @classmethod
    def of(cls, table: "pd.DataFrame") -> "_Outcomes":
        speeds = [f"{speed:g}" for speed in table["vut_speed_kmh"]]
        columns = [table[name].astype(str).to_numpy() for name in GROUP_COLUMNS[:-1]]
        return cls(
            words=(*columns, np.array(speeds)),
            weight=table["weight"].to_numpy(dtype=float),
            is_avoided=table["is_avoided"].to_numpy(dtype=bool),
        )

    def in_group(self, group: Sequence[str]) -> tuple[float | None, int, int]:
        """Ratio, runs and avoided ones of a group of words.

        No ratio without weight.
        """
        mask = np.ones(len(self.weight), dtype=bool)
        for words, word in zip(self.words, group, strict=True):
            if word != ALL:
                mask &= words == word
        total = float(self.weight[mask].sum())
        avoided = mask & self.is_avoided
        if total > 0.0:
            ratio = float(self.weight[avoided].sum()) / total
        else:
            ratio = None
        return ratio, int(mask.sum()), int(avoided.sum())


def _check_exports(
    folder: Path,
    layout: Layout,
    scene: Scene | None,
    names: set[str],
    found: FolderChecks,
) -> set[str]:
    """Other files with the layout say what ``layout.json`` says.

    Returns those compared.
    """
    if scene is None:
        expected = {}
    else:
        expected = {_CSV: to_csv(layout, scene)}
    if scene is not None and scene.crs:
        expected[_GEOJSON] = to_geojson(layout, scene.crs, scene)
    compared = names & ({_CSV} | set(expected))
    for name in sorted(compared):
        text = read_bytes(folder / name).decode(errors="replace")
        if text == expected.get(name):
            wrong = ""
        else:
            wrong = f"another layout than {LAYOUT_FILE}"
        if name not in expected:
            wrong = _csv_difference(text, layout)
        found.add(name, wrong, f"the units of {LAYOUT_FILE}")
    return compared


def _csv_difference(text: str, layout: Layout) -> str:
    """Differences of a table of units from a layout.

    Places in a map are not compared.
    """
    rows = list(csv.DictReader(io.StringIO(text)))
    records = layout_records(layout)
    if len(rows) != len(records):
        return f"{len(rows)} units, not {len(records)}"
    for row, record in zip(rows, records, strict=True):
        for key, value in record.items():
            got = plain_cell(row.get(key, ""))
            same = got == value
            if isinstance(value, float):
                with suppress(TypeError, ValueError):
                    same = abs(float(got) - value) <= _TOLERANCE
            if not same:
                return f"{record['id']}: {key} {got}, not {value}"
    return ""
