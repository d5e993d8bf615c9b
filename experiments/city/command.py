"""``place-rsus city``: units for the junctions of a city under one budget."""

from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from placement.compute import Compute
from placement.question import Question

from ..cli.options import (
    JUDGED,
    OF_SCENE,
    SectionedCommand,
    compute_options,
    json_option,
    option,
    question_options,
    quiet_option,
)
from ..cli.running import command_line, print_result
from ..cli.terminal import sentences, table
from ..progress import StageProgress, tell
from ..results.numbers import percent
from ..scene.command import reading_options

if TYPE_CHECKING:
    from .answer import CityResult

_MOUNTED = ("site_capacity", "site_cost_eur", "separation_m", "sensors")
_SOUGHT = ("solver", "time_limit_s", "gap", "fusion")
_TIME_LIMIT_S = 30.0  # for the optimiser at each junction
_DRIVEN = tuple(
    name
    for name in JUDGED
    # Accidents count around each junction; --near is about areas here.
    if name not in (*OF_SCENE, "near", "vut_sensors", "packet_loss", "vam_rate", "strict")
)
_MAX_LISTED = 12
_FILE: dict[str, Any] = {"type": click.Path(path_type=Path), "metavar": "FILE", "is_path": True}


def _count(what: str, least: int = 1) -> dict[str, Any]:
    return {
        "type": click.IntRange(min=least),
        "metavar": "N",
        "expected": f"{what}, at least {least}",
    }


def _amount(metavar: str, expected: str, **limits: Any) -> dict[str, Any]:
    kind = click.FloatRange(**{"min": 0.0, **limits})
    return {"type": kind, "metavar": metavar, "expected": expected}


_UNITS = _count("a number of units")
_METRES = _amount("METRES", "metres, more than 0", min_open=True) | {"show_default": True}
_rare = partial(option, is_common=False)


@click.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus city town.osm.pbf --budget-eur 400000 --out city
  place-rsus city town.osm.pbf --budget 60 --within centre.geojson --out city
  place-rsus city town.osm.pbf --budget-eur 400000 --out city \\
      --junction-weights accidents.csv --snap 40
  place-rsus city town.osm.pbf --budget 60 --units-per-year 20 --out city \\
      --districts districts.geojson --min-district-apr 0.3
  place-rsus city roads.osm houses.gpkg --budget 60 --signals-only --out city""",
)
@click.argument("maps", nargs=-1, required=True, metavar="MAP...", type=click.Path(path_type=Path))
@option(
    "--budget",
    "budget_units",
    **_count("a whole number of units", least=0),
    help="Most new units at all junctions together.",
)
@option(
    "--budget-eur",
    "budget_eur",
    **_amount("EUR", "euros, at least 0"),
    help="Most money to spend on units and sites.",
)
@option(
    "--out",
    required=True,
    type=click.Path(path_type=Path, file_okay=False),
    metavar="FOLDER",
    help="New folder, or one of the same city: junctions that are done are not done again.",
)
@option("--within", **_FILE, help="Only junctions in these areas: GeoJSON, GeoPackage, Shapefile.")
@option(
    "--junctions",
    default="",
    metavar="NAMES",
    is_path=True,
    help='Only these, by id or name with semicolons between ("A / B; C / D"), or a file with one '
    "a line.",
)
@option(
    "--min-arms",
    **_count("a number of arms"),
    default=3,
    show_default=True,
    help="Of a junction that counts.",
)
@option("--signals-only", is_flag=True, help="Only junctions with traffic lights.")
@option(
    "--junction-weights",
    "weights_file",
    **_FILE,
    help="Accidents or traffic: points (CSV with lat and lon, or x and y; GeoJSON, GeoPackage), or "
    "a CSV with a column junction. Default: every junction counts the same.",
)
@_rare(
    "--weight-column",
    default="",
    metavar="NAME",
    needs="weights_file",
    help="Of --junction-weights.",
)
@_rare(
    "--snap",
    "snap_m",
    needs="weights_file",
    default=50.0,
    **_METRES,
    help="A point counts at the nearest junction no farther away.",
)
@_rare("--districts", **_FILE, help="Areas in each of which --min-district-apr is reached.")
@_rare(
    "--min-district-apr",
    needs="districts",
    **_amount("SHARE", "a share of the accidents, 0 to 1", max=1.0),
    default=0.0,
    help="Of the accidents of each district, by weight.",
)
@_rare(
    "--areas",
    **_FILE,
    help="Schools and the like, with columns min_apr (each junction there reaches it) or weight "
    "(a factor on the weights there).",
)
@_rare(
    "--near",
    "near_m",
    needs="areas",
    **_amount("METRES", "metres, at least 0"),
    default=0.0,
    help="Junctions no farther from an area of --areas count as in it.",
)
@_rare(
    "--units-per-year",
    **_UNITS,
    help="Mounted in a year at most: the result says in which year each junction is ready.",
)
@_rare(
    "--years",
    needs="units_per_year",
    **_count("a number of years"),
    help="With --units-per-year: no more than so many years.",
)
@option(
    "--keep",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="LAYOUT",
    is_path=True,
    help="Existing units: a layout file of a junction's scene, or an earlier folder of the city. "
    "Can be given again.",
)
@option(
    "--coarse",
    "is_coarse",
    is_flag=True,
    help="Try a ninth of the poses: one height, every 30 degrees. Less memory, worse layouts.",
)
@_rare(
    "--max-units",
    default=6,
    show_default=True,
    **_UNITS,
    help="New units at one junction, at most.",
)
@_rare(
    "--max-junction-seconds",
    "max_junction_s",
    **_amount("SECONDS", "seconds, more than 0", min_open=True),
    default=300.0,
    show_default=True,
    help="For each junction, all in all; --time-limit is the optimiser's part of it.",
)
@_rare(
    "--radius",
    "radius_m",
    default=80.0,
    **_METRES,
    help="Around a junction; things farther away are left out.",
)
@option(
    "--sites",
    default="auto",
    show_default=True,
    metavar="WHERE",
    help="map, kerb:15, or a CSV or GeoJSON file, as in `scene import`; auto: map, but for low "
    "sign posts and poles of other junctions, and kerb:15 where none is within 25 m.",
)
@_rare(
    "--worker-memory",
    default="1.5GiB",
    show_default=True,
    metavar="SIZE",
    help="Of each process on this machine; one that takes more is ended, and its junction tried "
    "again.",
)
@reading_options
@question_options(*_MOUNTED, *_SOUGHT, *_DRIVEN, defaults={"time_limit_s": _TIME_LIMIT_S})
@json_option
@quiet_option
@compute_options()
@click.pass_obj
def city(
    progress: StageProgress,
    /,
    *,
    maps: tuple[Path, ...],
    out: Path,
    worker_memory: str,
    question: Question,
    as_json: bool,
    quiet: bool,
    compute: Compute,
    **given: Any,
) -> None:
    """Choose units for the junctions of a city under one budget.

    Each junction of the maps is cut out, and its front is found: what each number of units, and
    each sum of money, buys there. One exact choice over all fronts says who gets what; the folder
    has a report with a map, what to order, and every junction's own scene and page.
    """
    if given["budget_units"] is None and given["budget_eur"] is None:
        raise click.UsageError(
            "--budget: got nothing; expected a whole number of units, at least 0, or --budget-eur"
        )
    progress.start(quiet=quiet)
    from . import run as job
    from .inputs import CitySearch, CityWish

    def announce(sentence: str) -> None:
        if not quiet:
            tell(f"place-rsus: {sentence}", err=True)

    result = job.run_city(
        question,
        maps=maps,
        wish=CityWish(**_of(CityWish, given)),
        search=CitySearch(**_of(CitySearch, given), gap=question.gap),
        n_workers=compute.workers,
        memory=worker_memory,
        out=out,
        seed=compute.seed,
        command=command_line(),
        progress=progress,
        tell=announce,
    )
    print_result(result, progress, as_json, lambda: city_text(result, out))


def _of(kind: Any, given: dict[str, Any]) -> dict[str, Any]:
    """Options that are called as the fields of a dataclass."""
    return {field.name: given[field.name] for field in fields(kind) if field.name in given}


def city_text(result: "CityResult", out: Path) -> str:
    """A city's answer for the terminal: sentences, units by junction, junctions not done."""
    served = sorted((one for one in result.junctions if one.units), key=lambda one: -one.gain)
    failed = [one for one in result.junctions if one.reason]
    lines = sentences(*result.sentences)
    rows = [
        [one.label, str(one.units), f"{one.cost_eur:,.0f}", percent(one.apr), percent(one.gain)]
        for one in served[:_MAX_LISTED]
    ]
    if served:
        lines += ["", *table(["junction", "units", "EUR", "APR", "of the city"], rows)]
        lines += _more(len(served))
    if failed:
        lines += ["", "Not done:"]
        for one in failed[:_MAX_LISTED]:
            lines += sentences(f"{one.label}: {one.reason}", indent=2, hanging=2)
        lines += _more(len(failed))
    lines += ["", *sentences(f"Weights: {result.weights}."), *sentences(*result.notes)]
    return "\n".join([*lines, f"Written to {out}: report.html, city.gpkg, poles.csv and more."])


def _more(n: int) -> list[str]:
    return [f"  and {n - _MAX_LISTED} more: junctions.csv"] if n > _MAX_LISTED else []
