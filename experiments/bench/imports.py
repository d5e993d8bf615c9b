"""Map files from import to runs: ``python -m experiments.bench.imports FOLDER``.

Writes ``imports.md`` and a plan of each junction: arms, lanes, things, sites, runs, share of the
possible runs that is driven, seconds.
"""

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from geometry.errors import InputError
from geometry.junction import build_junction
from geometry.maps.importing import (
    SUFFIXES,
    ImportedScene,
    ImportOptions,
    import_scene,
)
from geometry.notes import assumptions
from placement.question import Question
from placement.setting import Setting, build_setting
from scenarios.staging import BENDS, ON_ROAD, lateral_acceleration_mps2

from ..figures.axes import to_png
from ..results.tables import markdown_table
from ..scene.pictures import plot_scene_plan

_NO_MAPS = ("_16mm.json", "_8mm.json", ".boundary.geojson")  # calibrations, outlines
_BESIDE_M = 14.0  # from the middle of the junction to the corner of the houses
_HEADS = (
    *("file", "junction", "arms", "lanes", "things", "sites", "of them kerb", "runs"),
    *("driven of possible", "driven of all", "no kerb", "too fast for bends"),
    *("largest to the side (m/s²)", "most often refused", "assumed"),
    *("read and cut (s)", "lay runs (s)"),
)


@click.command()
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--junctions", default=1, show_default=True, help="Largest junctions of each file.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("results"), show_default=True)
def main(folder: Path, junctions: int, out: Path) -> None:
    """Import every map file below FOLDER, and lay the default runs at its largest junctions."""
    pictures = out / "imports"
    pictures.mkdir(parents=True, exist_ok=True)
    rows, notes = [], []
    for path in sorted(folder.rglob("*")):
        if not path.name.lower().endswith(SUFFIXES) or path.name.endswith(_NO_MAPS):
            continue
        try:
            for row in _run(path, junctions, pictures):
                rows.append(row)
                click.echo(f"{path.name}: {row}")
        except InputError as error:
            notes.append(f"* {path.name}: {error}".replace(f"{folder}/", ""))
            click.echo(notes[-1])
    command = f"uv run python -m experiments.bench.imports FOLDER --junctions {junctions}"
    text = _page(rows, notes, command)
    (out / "imports.md").write_text(text, encoding="utf-8")


def _run(path: Path, n_junctions: int, pictures: Path) -> Iterator[list[str]]:
    """A row for each of the largest junctions; the first one's plan is drawn."""
    ids = [""]
    for number in range(n_junctions):
        if number == len(ids):
            return
        began_s = time.perf_counter()
        imported = import_scene([path], ImportOptions(junction=ids[number]))
        ids = ["", *(one.junction.id for one in imported.junctions[1:])]
        cut_s = time.perf_counter() - began_s
        if not number:
            stem = path.name.replace(" ", "-").replace(".", "-")
            (pictures / f"{stem}.png").write_bytes(to_png(plot_scene_plan(imported.scene)))
        yield _row(path.name, imported, cut_s)


def _row(name: str, imported: ImportedScene, cut_s: float) -> list[str]:
    scene = imported.scene
    began_s = time.perf_counter()
    setting = build_setting(Question(), scene)
    arms = build_junction(scene).arms
    n_lanes = sum(len(arm.entry_lanes) + len(arm.exit_lanes) for arm in arms.values())
    return [
        name,
        imported.chosen.junction.name or imported.chosen.junction.id,
        f"{len(arms)}: {', '.join(arms)}",
        str(n_lanes),
        str(sum(thing.class_name != "ground" for thing in scene.instances)),
        str(len(scene.sites)),
        str(sum(site.kind == "kerb" for site in scene.sites)),
        str(setting.axis.n_runs),
        *_driven(setting),
        _assumed(imported),
        f"{cut_s:.1f}",
        f"{time.perf_counter() - began_s:.1f}",
    ]


def _assumed(imported: ImportedScene) -> str:
    """How many things are assumed of each kind, as the answer lists them."""
    kinds = Counter(note.kind for note in assumptions(imported.scene.notes))
    return ", ".join(f"{kind} ({count})" for kind, count in kinds.items()) or "nothing"


def _driven(setting: Setting) -> tuple[str, ...]:
    """Shares of runs, the largest sideways acceleration, the reason that keeps most from it."""
    refused: Counter[str] = Counter()
    n_impossible = n_bends = n_no_kerb = 0
    for refusal in setting.refusals:
        n_speeds = len(refusal.speeds_kmh)
        n_bends += n_speeds * refusal.reason.startswith(BENDS)
        n_no_kerb += n_speeds * (ON_ROAD in refusal.reason)
        if refusal.is_possible:
            refused[refusal.reason] += n_speeds
        else:
            n_impossible += n_speeds
    n_possible = setting.axis.n_runs + refused.total()
    n_all = n_possible + n_impossible
    n_runs = setting.axis.n_runs
    shares = n_runs / n_possible, n_runs / n_all, n_no_kerb / n_all, n_bends / n_all
    most_mps2 = max(lateral_acceleration_mps2(run.encounter) for run in setting.runs)
    most = [f"{reason} ({count})" for reason, count in refused.most_common(1)]
    return *(f"{100.0 * share:.0f} %" for share in shares), f"{most_mps2:.1f}", (most or ["-"])[0]


def _page(rows: Sequence[Sequence[str]], notes: Sequence[str], command: str) -> str:
    lines = [
        "# Maps that others made, from file to runs",
        "",
        f"Made by `{command}`, at the largest junctions of each file, the default cases, the "
        "default camera; plans of the largest in `imports/`. Driven: the share of the runs, each "
        "case from each arm at each of seven places. A run is possible where the map has the road "
        "that it needs: not where no arm lies ahead or aside, where the arm ends before the place, "
        "where another junction's middle lies there, where no kerb to park at lies beside the lane "
        "and the case has parked cars or a wall there, where the lanes bend so sharply that its "
        "speed would ask for more than 4 m/s² to the side (these two also as shares of all runs: "
        "no kerb, too fast for bends), or where it is faster than the map's speed limit. To the "
        "side: the largest acceleration of a car before the impact. The reason is "
        "the one that keeps most possible runs away. Assumed: how many notes of each kind stand in "
        "the answer's list of what the map leaves open.",
        "",
        *markdown_table(_HEADS, rows),
    ]
    if notes:
        lines += ["", "Without runs:", "", *notes]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
