"""``place-rsus verify``: check a folder of results without the optimiser."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geometry.errors import InputError, Unquoted
from geometry.files import read_text
from geometry.scene import Scene
from geometry.scene_files import load_scene
from geometry.study_scene import STUDY, load_study_scene
from placement.layout import Layout, layout_records, load_layout
from placement.verification.certificates import CERTIFICATE_FILE, load_certificate
from placement.verification.instances import INSTANCE_FILE, load_stored_problem
from placement.verification.mounts import Mounts, scene_hash
from placement.verification.verify import verify_certificate

from ..progress import StageProgress
from ..results.folders import LAYOUT_FILE, MARKER
from ..results.solutions import CheckRecord, VerificationResult, VerifiedStageRecord

if TYPE_CHECKING:
    from .folder_checks import FolderChecks


def run_verification(
    folder: Path, *, scene: str = "", progress: StageProgress
) -> VerificationResult:
    """Check a result folder: certificate, instance and layout, and every other file beside them.

    Parameters
    ----------
    folder : Path
        As an optimisation has written it.
    scene : str
        Where the scene is that it was made in; empty: the study's junction, if it says so.
    progress : StageProgress
        Is told the stages.

    Raises
    ------
    InputError
        There is no such folder, or a file in it is missing, damaged or no such file at all.
    """
    from .folder_checks import FolderChecks, check_folder_files  # loads pandas

    if not folder.is_dir():
        raise InputError(str(folder), Unquoted("no folder"), "a folder with results")
    progress("read", 0, 0)
    stored = load_certificate(folder / CERTIFICATE_FILE)
    problem, mounts = load_stored_problem(folder / INSTANCE_FILE)
    summary = _load_summary(folder / MARKER)
    layout = _load_layout(folder, summary)
    # A recording's units have no poses: they stand in its summary alone.
    shown = layout_records(layout) if layout is not None else _recorded_units(summary)
    found = verify_certificate(
        problem,
        stored,
        shown,
        mounts=mounts,
        units=() if layout is None else layout.units,
        on_stage=lambda stage: progress(stage, 0, 0),
    )
    progress("compare files", 0, 0)
    beside = FolderChecks()
    known = _check_scene(scene, mounts, layout, problem.table.pose_ids, beside)
    files = check_folder_files(folder, stored, problem, layout, summary, known)
    proofs = {proof.name: proof._asdict() for proof in found.proofs}
    return VerificationResult(
        folder=str(folder),
        is_verified=found.passed and all(check.passed for check in (*beside.checks, *files.checks)),
        checks=(
            *(CheckRecord(**check._asdict()) for check in found.checks),
            *(*beside.checks, *files.checks),
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
        not_checked=(
            "whether the detection table is right: the evaluator's disagreement with it is in "
            "the report",
            *(
                f"that no layout is better in {proof.name}: this rests on {stored.solver}"
                for proof in found.proofs
                if proof.claims_optimum and proof.reason == stored.solver
            ),
            *(*beside.not_checked, *files.not_checked),
        ),
        seconds=progress.finish(),
    )


def _load_layout(folder: Path, summary: Mapping[str, Any] | None) -> Layout | None:
    """The layout file; None of a recording, whose units have no poses."""
    path = folder / LAYOUT_FILE
    if not path.exists() and summary is not None and "recording" in summary:
        return None
    return load_layout(path)


def _load_summary(path: Path) -> Mapping[str, Any] | None:
    """What the summary says; None if there is none."""
    if not path.exists():
        return None
    text = read_text(path, "JSON")
    try:
        summary = json.loads(text)
    except RecursionError:
        raise InputError(str(path), Unquoted("JSON nested too deep"), "a summary") from None
    except ValueError as error:  # no JSON, no UTF-8, or a number of thousands of digits
        raise InputError(str(path), Unquoted(error), "JSON in UTF-8") from None
    if not isinstance(summary, dict):
        raise InputError(str(path), Unquoted("no object"), "a summary")
    if "recording" not in summary:
        from ..parts.reading import check_schema  # loads pandas

        check_schema(summary, str(path))
    return summary


def _recorded_units(summary: Mapping[str, Any] | None) -> list[Mapping[str, Any]]:
    """Units in a recording's summary; none if it is no such thing."""
    units = None if summary is None else summary.get("layout")
    if not isinstance(units, list) or not all(isinstance(unit, dict) for unit in units):
        return []
    return units


def _check_scene(
    source: str,
    mounts: Mounts | None,
    layout: Layout | None,
    pose_ids: tuple[str, ...],
    found: "FolderChecks",
) -> Scene | None:
    """Compare the scene that is said with the one at hand; returns it if it is the same one."""
    if mounts is None:
        if layout is not None:
            found.not_checked.append(
                "positions, directions and sensor models of the units, and the scene: "
                f"{INSTANCE_FILE} does not say what its poses are"
            )
        return None
    shown = "" if layout is None else layout.scene_name
    same_name = shown == mounts.scene_name
    found.add(
        "scene",
        "" if same_name else f"{LAYOUT_FILE} says {shown or 'nothing'}, not {mounts.scene_name}",
        mounts.scene_name,
    )
    if not source and mounts.scene_name != STUDY:
        found.not_checked.append(
            f"whether {mounts.scene_name} is the scene that it is said to be: --scene tells where "
            "it is"
        )
        return None
    scene = load_scene(source) if source else load_study_scene()
    digest = scene_hash(scene)
    if digest != mounts.scene_sha256:
        text = f"SHA-256 {digest[:16]}.., not {mounts.scene_sha256[:16]}..; it may have changed"
        found.add("scene as it stands", text if source else f"{text} with the version", "")
        return None
    feet = {site.id: site.position_m for site in scene.sites}
    astray = mounts.misnamed(pose_ids, feet)
    found.add("scene as it stands", astray, f"SHA-256 {digest[:16]}.., and poses are at its sites")
    return scene
