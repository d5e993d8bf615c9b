"""What ``place-rsus verify`` does: a folder of results, checked without the optimiser."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from geometry.errors import InputError, Unquoted
from placement.layout import layout_records, load_layout
from placement.verification.certificates import (
    CERTIFICATE_FILE,
    INSTANCE_FILE,
    load_certificate,
    load_problem,
)
from placement.verification.verify import verify_certificate

from ..progress import StageProgress
from ..results.folders import LAYOUT_FILE, MARKER
from ..results.solutions import CheckRecord, VerificationResult, VerifiedStageRecord


def run_verification(folder: Path, *, progress: StageProgress) -> VerificationResult:
    """Check the certificate in a result folder against the instance and the layout beside it.

    Parameters
    ----------
    folder : Path
        As an optimisation has written it.
    progress : StageProgress
        Is told the stages.

    Raises
    ------
    InputError
        There is no such folder, or a file in it is missing, damaged or no such file at all.
    """
    if not folder.is_dir():
        raise InputError(str(folder), Unquoted("no folder"), "a folder with results")
    progress("read", 0, 0)
    stored = load_certificate(folder / CERTIFICATE_FILE)
    problem = load_problem(folder / INSTANCE_FILE)
    found = verify_certificate(
        problem,
        stored,
        _shown_units(folder),
        on_stage=lambda stage: progress(stage, 0, 0),
    )
    proofs = {proof.name: proof._asdict() for proof in found.proofs}
    return VerificationResult(
        folder=str(folder),
        is_verified=found.passed,
        checks=tuple(CheckRecord(**check._asdict()) for check in found.checks),
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
        ),
        seconds=progress.finish(),
    )


def _shown_units(folder: Path) -> Sequence[Mapping[str, Any]]:
    """Units of the layout file; of a recording, whose units have no poses, of its summary."""
    if not (folder / LAYOUT_FILE).exists():
        units = _recorded_units(folder / MARKER)
        if units is not None:
            return units
    return layout_records(load_layout(folder / LAYOUT_FILE))


def _recorded_units(path: Path) -> Sequence[Mapping[str, Any]] | None:
    """Units in a recording's summary; None if it is no such thing."""
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        units = summary["layout"] if "recording" in summary else None
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return None
    if not isinstance(units, list) or not all(isinstance(unit, dict) for unit in units):
        return None
    return units
