"""``place-rsus scenarios``: look at what is driven, without placing anything."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from placement.question import Question

from .call import print_result
from .cli_options import json_option, one_run_options, question_options, quiet_option
from .progress import StageProgress


@click.group(
    epilog="""\b
Examples:
  place-rsus scenarios list                     every case, on every approach
  place-rsus scenarios list --cases study --json
  place-rsus scenarios show CPNCO-50 --approach east --speed 40
  place-rsus scenarios show CPTAfs-50 --approach north --speed 20 --out a.gif
  place-rsus scenarios export CBNA --approach west --speed 60 --out a.xosc"""
)
def scenarios() -> None:
    """What is driven at the junction: list it, look at it, export it."""


@scenarios.command(
    "list",
    epilog="""\b
Examples:
  place-rsus scenarios list --cases protocol-4.5.1 --approaches east,west""",
)
@question_options(cases="all", has_weights=False)
@json_option
@quiet_option
@click.pass_obj
def list_scenarios(
    progress: StageProgress, *, question: Question, as_json: bool, quiet: bool
) -> None:
    """Cases by approach: speeds, runs, the last moment to brake, and why not.

    The last moment is the time at which braking must have begun, relative to the impact: -1.2 is
    1.2 seconds before it. With --json a list, one entry per case and approach, with one last
    moment per speed; null where braking cannot help.
    """
    from geometry.scene_folders import find_scene
    from placement.driving import drive

    from .scenario_list import list_rows, scenario_table

    progress.start(quiet=quiet)
    progress("lay the cases", 0, 0)
    rows = list_rows(drive(question, find_scene(question.scene)))
    print_result(rows, progress, as_json, lambda: scenario_table(rows))


@scenarios.command(
    epilog="""\b
Examples:
  place-rsus scenarios show CPNCO-50 --approach east --speed 40
  place-rsus scenarios show CBTAfo-50 --approach south --speed 15 --out a.gif"""
)
@one_run_options()
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Film strip (.png, .svg, .pdf) or animation (.gif); default: a .png in results/scenarios.",
)
@quiet_option
@click.pass_obj
def show(progress: StageProgress, *, question: Question, out: Path | None, quiet: bool) -> None:
    """Draw a run from above: bodies, paths, obstruction, what the VUT has in sight."""
    from geometry.scene_folders import find_scene
    from placement.driving import drive_one

    from .film import save_film

    scene = find_scene(question.scene)
    run = drive_one(question, scene)
    path = out or Path("results", "scenarios", run.id.replace("/", "_") + ".png")
    progress.start(quiet=quiet)
    progress("draw", 0, 0)
    _write(
        path,
        lambda: save_film(
            path,
            scene,
            run,
            on_progress=lambda done, total: progress("draw", done, total),
        ),
        makes_folder=out is None,
    )
    progress.stop()
    click.echo(f"Written to {path}.")


@scenarios.command(
    epilog="""\b
Examples:
  place-rsus scenarios export CPNA-25 --approach east --speed 10 --out a.xosc"""
)
@one_run_options()
@click.option("--out", type=click.Path(path_type=Path), help="File to write; else stdout.")
def export(*, question: Question, out: Path | None) -> None:
    """Write a run as OpenSCENARIO XML, for the roads of an OpenDRIVE file."""
    from geometry.atomic_files import write_atomically
    from geometry.scene_folders import find_scene
    from placement.driving import drive_one

    from .openscenario import to_openscenario

    scene = find_scene(question.scene)
    text = to_openscenario(drive_one(question, scene), road_network=scene.road_network)
    if out is None:
        click.echo(text, nl=False)
    else:
        _write(out, lambda: write_atomically(out, lambda file: file.write(text.encode())))


def _write(path: Path, write: Callable[[], Any], *, makes_folder: bool = False) -> None:
    try:
        if makes_folder:
            path.parent.mkdir(parents=True, exist_ok=True)
        write()
    except OSError as error:
        raise click.UsageError(
            f"--out: got {path}: {error.strerror}; expected a file that can be written"
        ) from None
