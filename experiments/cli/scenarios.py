"""``place-rsus scenarios``: what is driven, without placing anything."""

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from geometry.errors import InputError, Unquoted
from geometry.writing import is_about
from placement.question import Question

from ..language import mark
from ..progress import StageProgress, tell
from ..results.numbers import grouped, several
from . import options
from .running import Call, begin, unwritable, write_result
from .terminal import sentences, table

if TYPE_CHECKING:
    from geometry.scene import Scene
    from placement.setting import Drives
    from scenarios.runs import Run
    from scenarios.trajectories import Track


class DrivenRow(msgspec.Struct, frozen=True, kw_only=True):
    """A case from an approach at a position along the arms.

    What ``--json`` prints a list of.

    One last brake time per speed, relative to the impact, None where braking cannot
    help: the earliest where whoever is met has several speeds. The reason says what is
    not driven and why, None where every speed is driven.
    """

    case: str
    title: str
    road_user: str
    approach: str
    position: str
    speeds_kmh: tuple[float, ...]
    vru_speeds_kmh: tuple[float, ...]
    n_runs: int
    last_brake_time_s: tuple[float | None, ...]
    reason: str | None


def list_rows(drives: "Drives") -> list[DrivenRow]:
    """One row per case, approach and position.

    With what is driven and what is refused.
    """
    from scenarios.positions import sort_positions

    refusals = (*drives.refused, *drives.left_out)
    driven = grouped(
        ((run.case.name, run.approach, run.position), run) for run in drives.runs
    )
    refused = grouped(
        ((one.case.name, one.approach, one.position), one) for one in refusals
    )
    keys = list(dict.fromkeys((*driven, *refused)))
    # By case in the order asked for, within it by approach, and as the VUT passes them.
    cases = list(dict.fromkeys(case for case, _, _ in keys))
    pairs = list(dict.fromkeys(key[:2] for key in keys))
    positions = sort_positions(key[2] for key in keys)
    keys.sort(
        key=lambda k: (cases.index(k[0]), pairs.index(k[:2]), positions.index(k[2]))
    )
    described = {run.case.name: run.case for run in drives.runs}
    described |= {one.case.name: one.case for one in refusals}
    rows = []
    for key in keys:
        runs = driven.get(key, [])
        reasons = refused.get(key, [])
        n_refused = sum(len(one.speeds_kmh) for one in reasons)
        # Several runs have the same speed and differ elsewhere: the earliest time is
        # shown.
        times = grouped((run.vut_speed_kmh, run.last_brake_time_s) for run in runs)
        earliest_s = [min(of_speed) for of_speed in times.values()]
        name, approach, position = key
        row = DrivenRow(
            case=name,
            title=described[name].title,
            road_user=described[name].road_user,
            approach=approach,
            position=position,
            speeds_kmh=tuple(times),
            vru_speeds_kmh=tuple(sorted({run.case.vru_speed_kmh for run in runs})),
            n_runs=len(runs),
            last_brake_time_s=tuple(
                t if math.isfinite(t) else None for t in earliest_s
            ),
            reason="; ".join(
                (
                    f"at {one.speeds_text} km/h: {one.reason}"
                    if runs or n_refused > len(one.speeds_kmh)
                    else one.reason
                )
                for one in reasons
            )
            or None,
        )
        rows.append(row)
    return rows


def scenario_table(rows: Sequence[DrivenRow]) -> str:
    """The rows as a table, then who is met where, and what is not driven."""
    from scenarios.cases import load_unlaid_cases

    unlaid = [entry for entry in rows if entry.case in load_unlaid_cases()]
    rows = [entry for entry in rows if entry.case not in load_unlaid_cases()]
    groups = grouped(((entry.case, entry.approach), entry) for entry in rows)
    has_positions = len({entry.position for entry in rows}) > 1
    cells = []
    for (case, approach), entries in groups.items():
        n_places = sum(entry.n_runs > 0 for entry in entries)
        cells.append(
            [
                case,
                approach,
                _span(
                    sorted({speed for entry in entries for speed in entry.speeds_kmh}),
                    "g",
                ),
                *([f"{n_places} of {len(entries)}"] if has_positions else []),
                str(sum(entry.n_runs for entry in entries)),
                _last_moments(
                    [time for entry in entries for time in entry.last_brake_time_s]
                ),
            ]
        )
    for row, (before, after) in enumerate(pairwise(groups), start=1):
        # Each is named once.
        if before[0] == after[0]:
            cells[row][0] = ""
    if has_positions:
        places = ["places"]
    else:
        places = []
    heads = ["case", "from", "km/h", *places, "runs", "last moment to brake (s)"]
    lines = table(heads, cells, n_left=3, indent=0)
    lines += ["", *_who_meets_whom(rows)]
    if has_positions:
        lines += ["", *_position_table(rows), ""]
    from ..results.drives import describe_places

    refused = grouped(
        ((one.case, one.reason), (one.approach, one.position))
        for one in rows
        if one.reason
    )
    for (case, reason), where in refused.items():
        there = describe_places(grouped(where))
        lines += sentences(f"{case} from {there} not driven: {reason}", hanging=2)
    nowhere = grouped((one.reason or "", f"{one.case} ({one.title})") for one in unlaid)
    for why, cases in nowhere.items():
        lines += sentences(
            f"Not laid: {'; '.join(dict.fromkeys(cases))}: {why}", hanging=2
        )
    n_runs = sum(entry.n_runs for entry in rows)
    n_cases = len({entry.case for entry in rows})
    lines.append(f"{n_runs} runs of {several(n_cases, 'case', 'cases')}")
    return "\n".join(lines)


def _who_meets_whom(rows: Sequence[DrivenRow]) -> list[str]:
    """What happens in each case.

    Those that differ in the impact point share a sentence.
    """
    speeds = grouped(
        (entry.case, speed) for entry in rows for speed in entry.vru_speeds_kmh
    )
    alike: dict[str, dict[str, None]] = {}
    for entry in rows:
        title = entry.title.partition(", impact at")[0]
        at = _span(sorted(speeds.get(entry.case, [])), "g")
        if at:
            who = f"{entry.road_user}, {at} km/h"
        else:
            who = entry.road_user
        alike.setdefault(f"{title} ({who})", {})[entry.case] = None
    lines = []
    for what, names in alike.items():
        lines += sentences(f"{', '.join(names)}: {what}", hanging=2)
    return lines


def _position_table(rows: Sequence[DrivenRow]) -> list[str]:
    """Number of runs at each place along the arms."""
    from scenarios.positions import sort_positions

    cells = []
    for position in sort_positions(entry.position for entry in rows):
        there = [entry for entry in rows if entry.position == position and entry.n_runs]
        n_runs = sum(one.n_runs for one in there)
        n_cases = len({one.case for one in there})
        n_approaches = len({one.approach for one in there})
        cells.append([position, str(n_runs), str(n_cases), str(n_approaches)])
    return table(
        ["metres along the arms", "runs", "cases", "approaches"], cells, indent=0
    )


def _last_moments(times: Sequence[float | None]) -> str:
    known = sorted(time for time in times if time is not None)
    text = _span(known[::-1], ".2f")
    if len(known) < len(times):
        return f"{text}, {len(times) - len(known)} x never".removeprefix(", ")
    return text


def _span(values: Sequence[float], form: str) -> str:
    if not values:
        return ""
    low = f"{values[0]:{form}}"
    high = f"{values[-1]:{form}}"
    if low == high:
        return low
    if form != "g":
        return f"{low} to {high}"
    return f"{low}-{high}"


_EXAMPLES = """\b
Examples:
  place-rsus scenarios list                     every case, on every approach
  place-rsus scenarios list --cases study --json
  place-rsus scenarios show CPNCO-50 --approach east --speed 40
  place-rsus scenarios show CPTAfs-50 --approach north --speed 20 --out a.gif
  place-rsus scenarios export CBNA --approach west --speed 60 --out a.xosc"""


@click.group(epilog=_EXAMPLES)
def scenarios() -> None:
    """What is driven at the junction: list it, look at it, export it."""


_LIST_EXAMPLES = """\b
Examples:
  place-rsus scenarios list --cases protocol-4.5.1 --approaches east,west
  place-rsus scenarios list --cases CPNA --along-arms 0,20,40"""


@scenarios.command("list", cls=options.SectionedCommand, epilog=_LIST_EXAMPLES)
@options.question_options(
    *options.ONLY_DRIVEN, defaults={"cases": "all", "protect": "all"}
)
@options.calling
def list_scenarios(call: Call, *, question: Question) -> None:
    """Cases by approach and place.

    Speeds, runs, the last moment to brake, and why not.

    The last moment is the time at which braking must have begun, relative to the
    impact: -1.2 is 1.2 seconds before it. Places lie along the arms, in metres: -15 is
    so far before the junction, +0 the crosswalk of the arm straight ahead, +15 so far
    beyond it. With --json a list, one entry per case, approach and position, with one
    last moment per speed; null where braking cannot help.
    """
    from geometry.scene_sources import load_scene
    from placement.setting import drive
    from scenarios.cases import ALL_CASES

    question = begin(call.progress, question, quiet=call.quiet)
    call.progress(mark("lay the cases"), 0, 0)
    rows = list_rows(drive(question, load_scene(question.scene)))
    if ALL_CASES in question.cases.split(","):
        once = _driven_once()
    else:
        once = []
    call.print(rows, lambda: "\n".join([scenario_table(rows), *once]))


def _driven_once() -> list[str]:
    """What the set of all cases drives under the name of 2023 alone."""
    from scenarios.cases import ALL_CASES, load_case_sets, twins

    found = twins(load_case_sets()[ALL_CASES])
    named = "; ".join(f"{name} as {twin.name}" for name, twin in found.items())
    text = (
        "At speeds that 2023 and 2026 have in common driven once, under the name of"
        f" 2023: {named}."
    )
    return [*sentences(text, hanging=2), ""]


_SHOW_EXAMPLES = """\b
Examples:
  place-rsus scenarios show CPNCO-50 --approach east --speed 40
  place-rsus scenarios show CBTAfo-50 --approach south --speed 15 --out a.gif"""


@scenarios.command(epilog=_SHOW_EXAMPLES)
@options.one_run_options()
@options.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Film strip (.png) or animation (.gif); default: in results/scenarios.",
)
@options.quiet_option
@click.pass_obj
def show(
    progress: StageProgress,
    *,
    question: Question,
    position: str,
    out: Path | None,
    quiet: bool,
) -> None:
    """Draw a run from above.

    Bodies, paths, obstruction, what the VUT has in sight.
    """
    from ..figures.film import save_film

    scene, run = _drive_one(progress, question, position, quiet=quiet)
    path = out or Path("results", "scenarios", run.id.replace("/", "_") + ".png")
    progress(mark("draw"), 0, 0)
    try:
        if out is None:
            path.parent.mkdir(parents=True, exist_ok=True)
        save_film(path, scene, run, progress=progress)
    except OSError as error:
        if not is_about(error, path):
            raise
        raise unwritable(path, error) from None
    progress.stop()
    tell(f"Written to {path}.")


_IMPORT_EXAMPLES = """\b
Examples:
  place-rsus scenarios import fcd.xml --out near.toml
  place-rsus scenarios import ped.csv veh.csv --rate 23.98 --out near.toml
  place-rsus scenarios import a.csv --columns x=east,y=north --out near.toml
  place-rsus --scene junction --cases near.toml --budget 3"""


@scenarios.command("import", epilog=_IMPORT_EXAMPLES)
@click.argument(
    "paths", metavar="FILE..", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@options.option(
    "--ttc",
    "ttc_s",
    type=float,
    metavar="S",
    help="Longest time to collision; default: 2.",
)
@options.option(
    "--within",
    "within_m",
    type=float,
    metavar="M",
    help="Also pairs that come so near.",
)
@options.option(
    "--rate",
    "rate_hz",
    type=float,
    metavar="HZ",
    help="Of CSV files that count frames.",
)
@options.option(
    "--columns",
    default="",
    metavar="WHAT=NAME,..",
    help="Of CSV files: id=..,time=..,x=..",
)
@options.option(
    "--class",
    "class_name",
    default="",
    metavar="CLASS",
    help="Of CSV files without classes.",
)
@options.option(
    "--name",
    default="",
    help="What names of cases begin with; default: the first FILE's.",
)
@options.option(
    "--out",
    type=click.Path(path_type=Path),
    help="File to write; else stdout.",
)
def take_recordings(
    *,
    paths: tuple[Path, ...],
    ttc_s: float | None,
    within_m: float | None,
    rate_hz: float | None,
    columns: str,
    class_name: str,
    name: str,
    out: Path | None,
) -> None:
    """Read recorded trajectories, and write those who nearly met as cases.

    Files are CSV (id, time, x, y, and if wanted heading and class) or SUMO's
    floating car data, all of one place and clock. A pair counts if a vehicle and
    a vulnerable road user would touch within --ttc seconds if nobody changed speed or
    direction. It is replayed with both on their recorded ways up to that moment, and
    straight on from there at the same speeds.
    """
    from scenarios.conflicts import cases_text, find_encounters
    from scenarios.trajectories import read_tracks

    limits = (
        ("--ttc", ttc_s, 10.0),
        ("--within", within_m, 50.0),
        ("--rate", rate_hz, 1000.0),
    )
    for where, value, most in limits:
        if value is not None and not 0.0 < value <= most:
            raise InputError(where, value, f"a number, more than 0, at most {most:g}")
    named = dict(word.partition("=")[::2] for word in columns.split(",") if word)
    tracks: list[Track] = []
    n_left_out = 0
    for path in paths:
        read, n_more = read_tracks(
            path, columns=named, frame_rate_hz=rate_hz, class_name=class_name
        )
        tracks += read
        n_left_out += n_more
    if ttc_s is None and within_m is None:
        ttc_s = 2.0
    found, why = find_encounters(tracks, ttc_s=ttc_s, within_m=within_m)
    tell(
        f"{several(len(found), 'encounter', 'encounters')} of {len(tracks)} road users."
    )
    if n_left_out:
        tell(
            f"{n_left_out} road users of other classes, or seen only briefly, left out."
        )
    for reason, n_pairs in why.items():
        tell(f"{several(n_pairs, 'pair', 'pairs')} left out: {reason}.")
    if not found:
        raise InputError("encounters", Unquoted("none"), "a higher --ttc, or --within")
    source = ", ".join(path.name for path in paths)
    write_result(out, cases_text(found, name=name or paths[0].stem, source=source))


_EXPORT_EXAMPLES = """\b
Examples:
  place-rsus scenarios export CPNA-25 --approach east --speed 10 --out a.xosc"""


@scenarios.command(epilog=_EXPORT_EXAMPLES)
@options.one_run_options()
@options.option(
    "--out",
    type=click.Path(path_type=Path),
    help="File to write; else stdout.",
)
@click.pass_obj
def export(
    progress: StageProgress, *, question: Question, position: str, out: Path | None
) -> None:
    """Write a run as OpenSCENARIO XML, for the roads of an OpenDRIVE file.

    Where the scene names no such file, its roads are written beside --out, as .xodr.
    """
    from ..export.opendrive import to_opendrive
    from ..export.openscenario import to_openscenario

    scene, run = _drive_one(progress, question, position, quiet=True)
    roads = scene.road_network
    if out is not None and not roads:
        beside = out.with_suffix(".xodr")
        roads = beside.name
        write_result(beside, to_opendrive(None, scene))
    write_result(out, to_openscenario(run, road_network=roads))


def _drive_one(
    progress: StageProgress, question: Question, position: str, *, quiet: bool
) -> "tuple[Scene, Run]":
    from geometry.scene_sources import load_scene
    from placement.setting import drive_one

    question = begin(progress, question, quiet=quiet)
    scene = load_scene(question.scene)
    return scene, drive_one(question, scene, position=position)
