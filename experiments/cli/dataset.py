"""``place-rsus dataset``: pictures, point clouds and labels of many runs, to train detectors on."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from placement.compute import Compute
from placement.question import Question

from ..progress import StageProgress, tell
from .options import (
    PICTURED,
    SectionedCommand,
    compute_options,
    json_option,
    layout_option,
    option,
    question_options,
    quiet_option,
)
from .running import load_one_layout, print_result
from .terminal import sentences

if TYPE_CHECKING:
    from ..results.datasets import DatasetSummary


@click.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus dataset --layout carlancap-12 --cases CPNC-50,CBNA \\
      --out ncap_data
  place-rsus dataset --layout results/latest/layout.json --every 10 \\
      --weather day,night,rain --lidar none --format coco --out training
  place-rsus evaluate --recording ncap_data      reads it back""",
)
@layout_option
@option(
    "--out",
    required=True,
    type=click.Path(path_type=Path, file_okay=False),
    metavar="FOLDER",
    help="New folder, or one of the same dataset: what is there is not drawn again.",
)
@option(
    "--format",
    "form",
    type=click.Choice(("carlancap", "coco")),
    default="carlancap",
    show_default=True,
    help="carlancap: the study's folders; coco: pictures and coco.json.",
)
@option(
    "--units",
    default="",
    metavar="NAMES",
    help="Cameras of the layout, with commas between; VUT is the car's. Default: all.",
)
@option(
    "--every",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    metavar="N",
    expected="a number of frames, at least 1",
    help="A picture of every Nth frame of a run; labels and motion are of all frames.",
)
@option(
    "--lidar",
    default="carla-ncap-lidar",
    show_default=True,
    metavar="MODEL",
    help="Scans beside each camera; none for none.",
)
@option("--masks", is_flag=True, help="Also a picture of each frame's things, a colour each.")
@option("--depth", is_flag=True, help="Also depths: 16 bits, centimetres, 0 where nothing is.")
@option("--vehicles", is_flag=True, help="Also labels of vehicles, in frames with pictures.")
@option(
    "--vary",
    is_flag=True,
    help="Other clothes, paints and facades in each run, by seed; for training.",
)
@option(
    "--scheduler",
    default="",
    metavar="ADDRESS",
    help="Draw on the workers of a dask scheduler, which must have this program and see the "
    "folder; default: on this machine.",
)
@question_options(*PICTURED)
@json_option
@quiet_option
@compute_options()
@click.pass_obj
def dataset(
    progress: StageProgress,
    *,
    layout_names: tuple[str, ...],
    out: Path,
    form: str,
    units: str,
    every: int,
    lidar: str,
    masks: bool,
    depth: bool,
    vehicles: bool,
    vary: bool,
    scheduler: str,
    question: Question,
    as_json: bool,
    quiet: bool,
    compute: Compute,
) -> None:
    """Write a dataset: what the cameras of a layout see of all runs, with labels."""
    layout = load_one_layout(layout_names)
    progress.start(quiet=quiet)
    from ..jobs import dataset

    def announce(sentence: str) -> None:
        if not quiet:
            tell(f"place-rsus: {sentence}", err=True)

    summary = dataset.run_dataset(
        question,
        layout=layout,
        wish=dataset.DatasetWish(
            format=form,
            units=units,
            every=every,
            lidar=lidar,
            masks=masks,
            depth=depth,
            vehicles=vehicles,
            vary=vary,
            scheduler=scheduler,
        ),
        out=out,
        compute=compute,
        progress=progress,
        tell=announce,
    )
    print_result(summary, progress, as_json, lambda: _text(summary, form))


def _text(summary: "DatasetSummary", form: str) -> str:
    n_before = summary.pictures - summary.drawn
    was_there = f", {n_before:,} of them were there before" if n_before else ""
    lines = [
        f"{summary.pictures:,} pictures of {summary.units} cameras in {summary.folder}{was_there}: "
        f"{summary.frames:,} frames of {summary.runs} runs."
    ]
    if summary.drawn:
        each = summary.seconds / summary.drawn
        lines.append(
            f"{summary.size_bytes / 1e9:.2f} GB written, {each:.2f} s per picture on all "
            "processors together."
        )
    if form == "carlancap":
        lines.append(f"Read it back: place-rsus evaluate --recording {summary.folder}")
    return "\n".join(line for text in lines for line in sentences(text))
