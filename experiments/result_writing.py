"""What a command writes into a folder of results: layout, certificate, tables, report."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from placement.certificates import build_certificate, save_certificate
from placement.evaluation import Evaluation
from placement.pipeline import Placement
from placement.setting import Setting

from . import bill_of_materials, verdict_tables
from .bill_of_materials import BillOfMaterials, bill_of_materials_csv, build_bill
from .export_formats.json_text import to_json_text
from .export_formats.layout_file import to_json
from .export_formats.maps import to_geojson
from .export_formats.tables import to_csv
from .progress import WRITING, StageProgress
from .report import write_report
from .result_folder import MARKER, new_result_folder


def write_results(
    folder: Path,
    summary: dict[str, Any],
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    command: str,
    progress: StageProgress,
    placement: Placement | None = None,
    bill: BillOfMaterials | None = None,
    sampled_figure: Axes | None = None,
) -> None:
    """Fill a result folder; the times of all stages but the writing go into the summary.

    Parameters
    ----------
    folder : Path
        Replaced as a whole, or left as it was.
    summary : dict
        By :mod:`experiments.summary`; its "seconds" are filled in.
    setting : Setting
        What the layouts were judged in.
    evaluations : mapping of str to Evaluation
        By display name; the first one is the subject.
    command : str
        Command line that makes the result again.
    progress : StageProgress
        Told what is on disk in the end.
    placement : Placement, optional
        Where the subject was found: its certificate is written, too.
    bill : BillOfMaterials, optional
        Of the subject, where more is known of its costs than the scene tells.
    sampled_figure : Axes, optional
        Of the APR in sampled worlds.

    Raises
    ------
    OSError
        Something cannot be written.
    """
    progress(WRITING, 0, 0)
    summary["seconds"] = progress.seconds.copy()
    subject = next(iter(evaluations.values()))
    known = {key: value for key, value in summary.items() if value is not None}
    with new_result_folder(folder) as new:
        layout = replace(subject.layout, scene_name=setting.scene.name)
        _write_text(new / "layout.json", to_json(layout))
        _write_text(new / "layout.csv", to_csv(layout, setting.scene))
        if setting.scene.crs:  # else nobody knows where on earth it lies
            geojson = to_geojson(layout, setting.scene.crs, setting.scene)
            _write_text(new / "layout.geojson", geojson)
        if placement is not None:
            document = build_certificate(
                placement.problem,
                placement.certificate,
                pose_index=placement.pose_index,
                units=summary["layout"],
                presolve=placement.presolve,
                seconds=placement.seconds,
                versions=summary["versions"],
            )
            save_certificate(new, document, placement.problem)
        bill = bill or build_bill(layout, setting.scene)
        _write_text(new / bill_of_materials.FILE_NAME, bill_of_materials_csv(bill))
        verdict_tables.apr_table(evaluations).to_csv(new / "apr.csv", index=False)
        verdict_tables.runs_table(evaluations).to_parquet(new / "runs.parquet")
        write_report(
            new,
            known,
            setting,
            evaluations,
            command=command,
            sampled_figure=sampled_figure,
            bill=bill,
        )
        summary["seconds"] = progress.finish()
        _write_text(new / MARKER, to_json_text(summary))
    progress.kept = f"the results are in {folder}"


def left_as_it_was(folder: Path) -> str:
    """What is on disk as long as nothing has been written, in words."""
    if (folder / MARKER).exists():
        return f"the earlier results in {folder} are unchanged"
    return f"nothing was written to {folder}"


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
