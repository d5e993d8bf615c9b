"""Write a folder of results: layout, certificate, tables, report."""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import msgspec

from geometry.files import write_atomically
from placement.candidates import CandidatePose
from placement.evaluation import Evaluation
from placement.layout import Layout, layout_records
from placement.pipeline import Placement
from placement.setting import Setting
from placement.verification.certificates import build_certificate, save_certificate
from placement.verification.instances import build_mounts

from ..export.csv import to_csv
from ..export.geojson import to_geojson
from ..export.json import to_json, to_json_text
from ..parts import bill_of_materials
from ..parts.bill_of_materials import BillOfMaterials, bill_of_materials_csv, build_bill
from ..parts.result import Result
from ..progress import WRITING, StageProgress
from ..report.page import begin_tasks, write_report
from ..results.folders import (
    APR_FILE,
    LAYOUT_FILE,
    MARKER,
    RECOMMENDED_FILE,
    RUNS_FILE,
    new_result_folder,
    unwritable,
)
from ..results.tables import apr_table, csv_text, runs_table
from ..side_process import SideProcess

_R = TypeVar("_R", bound=Result)


def write_results(
    folder: Path,
    result: _R,
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    command: str,
    progress: StageProgress,
    placement: Placement | None = None,
    candidates: Sequence[CandidatePose] = (),
    recommended: Layout | None = None,
    bill: BillOfMaterials | None = None,
    side: SideProcess | None = None,
) -> _R:
    """Fill a result folder; returns the result with its "seconds", all stages but the writing.

    `folder` is replaced as a whole, or left as it was. The first evaluation is the subject;
    `candidates` are the rows of the placement's table, `recommended` is what the evaluator prefers,
    `bill` knows more of costs than the scene, `command` makes the result again. Raises InputError
    if something cannot be written: it names the folder where the answer is all the same.
    """
    progress(WRITING, 0, 0)
    result = msgspec.structs.replace(result, seconds=progress.seconds.copy())
    if side is not None:
        begin_tasks(side, result, setting, evaluations)  # drawn while other files are written
    subject = next(iter(evaluations.values()))
    layout = replace(subject.layout, scene_name=setting.scene.name)
    # The answer comes first: it is kept if anything that follows cannot be written.
    answer = {
        LAYOUT_FILE: to_json(layout, setting.scene),
        "layout.csv": to_csv(layout, setting.scene),
        MARKER: to_json_text(result),
    }
    if recommended is not None:
        recommended = replace(recommended, scene_name=setting.scene.name)
        answer[RECOMMENDED_FILE] = to_json(recommended)
    with _saved_elsewhere(folder, answer), new_result_folder(folder) as new:
        for name, text in answer.items():
            write_atomically(new / name, text)
        if setting.scene.crs:  # else nobody knows where on earth it lies
            geojson = to_geojson(layout, setting.scene.crs, setting.scene)
            write_atomically(new / "layout.geojson", geojson)
        if placement is not None:
            mounts = build_mounts(setting.scene, candidates)
            document = build_certificate(
                placement.problem,
                placement.certificate,
                pose_index=placement.pose_index,
                units=layout_records(layout),
                presolve=placement.presolve,
                seconds=placement.seconds,
                versions=result.versions,
                mounts=mounts,
            )
            save_certificate(new, document, placement.problem, mounts)
        bill = bill or build_bill(layout, setting.scene)
        write_atomically(new / bill_of_materials.FILE_NAME, bill_of_materials_csv(bill))
        write_atomically(new / APR_FILE, csv_text(apr_table(evaluations)))
        write_atomically(new / RUNS_FILE, runs_table(evaluations).to_parquet())
        write_report(new, result, setting, evaluations, command=command, bill=bill, side=side)
        result = msgspec.structs.replace(result, seconds=progress.finish())
        write_atomically(new / MARKER, to_json_text(result))
    progress.kept = f"the results are in {folder}"
    return result


@contextmanager
def _saved_elsewhere(folder: Path, answer: Mapping[str, str]) -> Iterator[None]:
    """Keep the answer among the system's temporary files if its folder cannot take even that."""
    try:
        yield
    except OSError as error:
        kept = Path(tempfile.mkdtemp(prefix="place-rsus-kept-"))
        for name, text in answer.items():
            write_atomically(kept / name, text)
        raise unwritable(folder, error, f"; layout and numbers are kept in {kept}") from error
