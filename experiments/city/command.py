"""``place-rsus city``: units for the junctions of a city under one budget."""

from dataclasses import fields
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
_FILE: dict[str, Any] = {
    "type": click.Path(path_type=Path),
    "metavar": "FILE",
    "is_path": True,
}
_UNITS: dict[str, Any] = {
    "type": click.IntRange(min=1),
    "metavar": "N",
    "expected": "a number of units, at least 1",
}
_METRES: dict[str, Any] = {
    "type": click.FloatRange(min=0.0, min_open=True),
    "show_default": True,
    "metavar": "METRES",
    "expected": "metres, more than 0",
}


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
    type=click.IntRange(min=0),
    metavar="N",
    expected="a whole number of units, at least 0",
    help="Most new units at all junctions together.",
)
@option(
    "--budget-eur",
    "budget_eur",
    type=click.FloatRange(min=0.0),
    metavar="EUR",
    expected="euros, at least 0",
    help="Most money to spend on units and sites.",
)
@option(
    "--out",
    required=True,
    type=click.Path(path_type=Path, file_okay=False),
    metavar="FOLDER",
    help="New folder, or one of the same city: junctions that are done are not done again.",
)
@option(
    "--within",
    **_FILE,
    help="Only junctions in these areas: GeoJSON, GeoPackage, Shapefile.",
)
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
    type=click.IntRange(min=1),
    default=3,
    show_default=True,
    metavar="N",
    expected="a number of arms, at least 1",
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
@option(
    "--weight-column",
    is_common=False,
    default="",
    metavar="NAME",
    needs="weights_file",
    help="Of --junction-weights.",
)
@option(
    "--snap",
    "snap_m",
    is_common=False,
    needs="weights_file",
    default=50.0,
    **_METRES,
    help="A point counts at the nearest junction no farther away.",
)
@option(
    "--districts",
    is_common=False,
    **_FILE,
    help="Areas in each of which --min-district-apr is reached.",
)
@option(
    "--min-district-apr",
    is_common=False,
    needs="districts",
    type=click.FloatRange(min=0.0, max=1.0),
    default=0.0,
    metavar="SHARE",
    expected="a share of the accidents, 0 to 1",
    help="Of the accidents of each district, by weight.",
)
@option(
    "--areas",
    is_common=False,
    **_FILE,
    help="Schools and the like, with columns min_apr (each junction there reaches it) or weight "
    "(a factor on the weights there).",
)
@option(
    "--near",
    "near_m",
    is_common=False,
    needs="areas",
    type=click.FloatRange(min=0.0),
    default=0.0,
    metavar="METRES",
    expected="metres, at least 0",
    help="Junctions no farther from an area of --areas count as in it.",
)
@option(
    "--units-per-year",
    is_common=False,
    **_UNITS,
    help="Mounted in a year at most: the result says in which year each junction is ready.",
)
@option(
    "--years",
    is_common=False,
    needs="units_per_year",
    type=click.IntRange(min=1),
    metavar="N",
    expected="a number of years, at least 1",
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
@option(
    "--max-units",
    is_common=False,
    default=6,
    show_default=True,
    **_UNITS,
    help="New units at one junction, at most.",
)
@option(
    "--max-junction-seconds",
    "max_junction_s",
    is_common=False,
    type=click.FloatRange(min=0.0, min_open=True),
    default=300.0,
    show_default=True,
    metavar="SECONDS",
    expected="seconds, more than 0",
    help="For each junction, all in all; --time-limit is the optimiser's part of it.",
)
@option(
    "--radius",
    "radius_m",
    is_common=False,
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
@option(
    "--worker-memory",
    is_common=False,
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
        workers=job.CityWorkers(n_workers=compute.workers, memory=worker_memory),
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
    lines = sentences(*result.sentences)
    if served:
        rows = [
            [one.label, str(one.units), f"{one.cost_eur:,.0f}", percent(one.apr), percent(one.gain)]
            for one in served[:_MAX_LISTED]
        ]
        lines += ["", *table(["junction", "units", "EUR", "APR", "of the city"], rows)]
        left = len(served) - len(rows)
        lines += [f"  and {left} more: junctions.csv"] if left > 0 else []
    failed = [one for one in result.junctions if one.reason]
    if failed:
        lines += ["", "Not done:"]
        for one in failed[:_MAX_LISTED]:
            lines += sentences(f"{one.label}: {one.reason}", indent=2, hanging=2)
        left = len(failed) - _MAX_LISTED
        lines += [f"  and {left} more: junctions.csv"] if left > 0 else []
    lines += ["", *sentences(f"Weights: {result.weights}.")]
    lines += sentences(*result.notes)
    lines.append(f"Written to {out}: report.html, city.gpkg, poles.csv and more.")
    return "\n".join(lines)
