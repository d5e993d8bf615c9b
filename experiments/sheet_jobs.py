"""What ``place-rsus sheet`` does: tolerances, then a page for each unit."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from geometry.atomic_files import write_atomically
from geometry.errors import InputError, Unquoted
from geometry.scene_folders import find_scene
from placement.driving import build_setting
from placement.layout import Layout, check_layout
from placement.question import Question
from placement.tolerance import find_tolerances

from .folder_files import check_folder
from .mounting_sheet import mounting_sheet
from .progress import WRITING, StageProgress


def run_sheet(
    question: Question,
    *,
    layout: Layout,
    out: Path,
    seed: int,
    workers: int,
    progress: StageProgress,
) -> dict[str, Any]:
    """Write the mounting sheet of a layout.

    Returns
    -------
    summary : dict
        ``{"layout", "written", "units": [{"unit_id", "yaw_deg": [right, left], "pitch_deg": [down,
        up], "height_m": [lower, higher]}], "seconds"}``: what each unit may be off.

    Raises
    ------
    InputError
        A unit hangs inside something, or `out` cannot be written.
    """
    if out.is_dir():
        raise InputError("--out", Unquoted(f"{out}, a folder"), "a PDF file to write")
    check_folder(out.parent)
    progress.kept = f"nothing was written to {out}"
    progress("setting", 0, 0)
    setting = build_setting(question, find_scene(question.scene))
    check_layout(layout, setting.scene)
    progress("tolerances", 0, 0)
    tolerances = find_tolerances(setting, layout.units, seed=seed, workers=workers)
    progress(WRITING, 0, 0)
    pdf = mounting_sheet(layout, setting, tolerances, seed=seed, workers=workers)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(out, lambda file: file.write(pdf))
    except OSError as error:
        raise InputError(
            "--out", Unquoted(f"{out}: {error.strerror or error}"), "a file that can be written"
        ) from None
    progress.kept = f"the sheet is in {out}"
    return {
        "layout": layout.name,
        "written": str(out),
        "units": [asdict(tolerance) for tolerance in tolerances],
        "seconds": progress.finish(),
    }


def sheet_text(summary: dict[str, Any]) -> str:
    """The same for a terminal, at most 80 columns wide."""
    lines = [f"What the units of {summary['layout']} may be off before a run is lost:"]
    heads = f"{'left':>6} {'right':>6} {'up':>6} {'down':>6} {'higher':>8} {'lower':>7}"
    lines.append(f"  {'unit':<20} {heads}")
    for unit in summary["units"]:
        (right, left), (down, up), (lower, higher) = (
            unit[key] for key in ("yaw_deg", "pitch_deg", "height_m")
        )
        lines.append(
            f"  {unit['unit_id'][:20]:<20} {left:>5g}\N{DEGREE SIGN} {right:>5g}\N{DEGREE SIGN} "
            f"{up:>5g}\N{DEGREE SIGN} {down:>5g}\N{DEGREE SIGN} {100 * higher:>5.0f} cm "
            f"{100 * lower:>4.0f} cm"
        )
    lines += ["  One thing at a time; the largest of the steps tried.", ""]
    return "\n".join([*lines, f"Written to {summary['written']}."])
