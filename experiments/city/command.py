"""``place-rsus city``: units for the junctions of a city under one budget."""

from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..cli import options
from ..cli.running import QuestionCall, command_line
from ..cli.terminal import sentences, table
from ..language import localized, tr
from ..results.numbers import percent
from ..scene.command import reading_options, sites_crs_option

if TYPE_CHECKING:
    from .answer import CityResult

_MOUNTED = ("site_capacity", "site_cost_eur", "separation_m", "sensors")
_SOUGHT = ("solver", "time_limit_s", "gap", "fusion")
# For the optimiser at each junction.
_TIME_LIMIT_S = 30.0
_DRIVEN = tuple(
    name
    for name in options.JUDGED
    # Accidents count around each junction; --near is about areas here.
    if name
    not in (
        *options.OF_SCENE,
        "near",
        "vut_sensors",
        "packet_loss",
        "vam_rate",
    )
)
_MAX_LISTED = 12
# A driver crosses both side roads in one go.
_STAGGERED_M = 40.0


_EXAMPLES = """\b
Examples:
  place-rsus city town.osm.pbf --budget-eur 400000 --out city
  place-rsus city town.osm.pbf --budget 60 --within centre.geojson --out city
  place-rsus city town.osm.pbf --budget-eur 400000 --out city \\
      --junction-weights accidents.csv --snap 40
  place-rsus city town.osm.pbf --budget 60 --units-per-year 20 --out city \\
      --districts districts.geojson --min-district-apr 0.3
  place-rsus city roads.osm houses.gpkg --budget 60 --signals-only --out city
  place-rsus city town.osm.pbf --budget 60 --out city \\
      --scheduler tls://10.0.0.1:8786 --tls-ca ca.pem --tls-cert me.pem"""


@click.command(cls=options.SectionedCommand, epilog=_EXAMPLES)
@click.argument(
    "maps", nargs=-1, required=True, metavar="MAP...", type=click.Path(path_type=Path)
)
@options.option(
    "--budget",
    "budget_units",
    type=click.IntRange(min=0),
    metavar="N",
    expected="a whole number of units, at least 0",
    help="Most new units at all junctions together.",
)
@options.option(
    "--budget-eur",
    type=click.FloatRange(min=0.0),
    metavar="EUR",
    expected="euros, at least 0",
    help="Most money to spend on units and sites.",
)
@options.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    required=True,
    metavar="FOLDER",
    help=(
        "New folder, or one of the same city: junctions that are done are not done"
        " again."
    ),
)
@options.option(
    "--within",
    type=click.Path(path_type=Path),
    metavar="FILE",
    is_path=True,
    help="Only junctions in these areas: GeoJSON, GeoPackage, Shapefile.",
)
@options.option(
    "--junctions",
    default="",
    metavar="NAMES",
    is_path=True,
    help=(
        'Only these, by id or name with semicolons between ("A / B; C / D"), or a '
        "file with one a line."
    ),
)
@options.option(
    "--min-arms",
    type=click.IntRange(min=1),
    default=3,
    metavar="N",
    expected="a number of arms, at least 1",
    help="Of a junction that counts.",
)
@options.option(
    "--signals-only",
    is_flag=True,
    help="Only junctions with traffic lights.",
)
@options.option(
    "--junction-weights",
    "weights_file",
    type=click.Path(path_type=Path),
    metavar="FILE",
    is_path=True,
    help=(
        "Accidents or traffic: points (CSV with lat and lon, or x and y; GeoJSON, "
        "GeoPackage), or a CSV with a column junction. proxy: estimated from class "
        "and lanes of the roads and from traffic lights. Default: every junction "
        "counts the same."
    ),
)
@options.option(
    "--weight-column",
    default="",
    metavar="NAME",
    is_common=False,
    needs="weights_file",
    help="Of --junction-weights.",
)
@options.option(
    "--counted-years",
    type=click.FloatRange(min=0.0, min_open=True),
    metavar="YEARS",
    is_common=False,
    needs="weights_file",
    expected="a number of years, more than 0",
    help=(
        "In which the accidents of --junction-weights happened: the answer says how "
        "many are prevented a year."
    ),
)
@options.option(
    "--snap",
    "snap_m",
    type=click.FloatRange(min=0.0, min_open=True),
    default=50.0,
    metavar="METRES",
    is_common=False,
    needs="weights_file",
    expected="metres, more than 0",
    help="A point counts at the nearest junction no farther away.",
)
@options.option(
    "--districts",
    type=click.Path(path_type=Path),
    metavar="FILE",
    is_common=False,
    is_path=True,
    help="Areas in each of which --min-district-apr is reached.",
)
@options.option(
    "--min-district-apr",
    type=click.FloatRange(min=0.0, max=1.0),
    default=0.0,
    metavar="SHARE",
    is_common=False,
    needs="districts",
    expected="a share of the accidents, 0 to 1",
    help="Of the accidents of each district, by weight.",
)
@options.option(
    "--areas",
    type=click.Path(path_type=Path),
    metavar="FILE",
    is_common=False,
    is_path=True,
    help=(
        "Schools and the like, with columns min_apr (each junction there reaches it) "
        "or weight (a factor on the weights there)."
    ),
)
@options.option(
    "--near",
    "near_m",
    type=click.FloatRange(min=0.0),
    default=0.0,
    metavar="METRES",
    is_common=False,
    needs="areas",
    expected="metres, at least 0",
    help="Junctions no farther from an area of --areas count as in it.",
)
@options.option(
    "--units-per-year",
    type=click.IntRange(min=1),
    metavar="N",
    is_common=False,
    expected="a number of units, at least 1",
    help=(
        "Mounted in a year at most: the result says in which year each junction is"
        " ready."
    ),
)
@options.option(
    "--years",
    type=click.IntRange(min=1),
    metavar="N",
    is_common=False,
    expected="a number of years, at least 1",
    help=(
        "That the money is for: with --units-per-year all is mounted in them, with "
        "--counted-years the answer says how many accidents are prevented in them."
    ),
)
@options.option(
    "--keep",
    type=click.Path(path_type=Path),
    multiple=True,
    metavar="LAYOUT",
    is_path=True,
    help=(
        "Existing units: a layout file of a junction's scene, or an earlier folder "
        "of the city. Can be given again."
    ),
)
@options.option(
    "--coarse",
    "is_coarse",
    is_flag=True,
    help=(
        "Try a ninth of the poses: one height, every 30 degrees. Less memory, worse"
        " layouts."
    ),
)
@options.option(
    "--max-units",
    type=click.IntRange(min=1),
    default=6,
    metavar="N",
    is_common=False,
    expected="a number of units, at least 1",
    help="New units at one junction, at most.",
)
@options.option(
    "--max-junction-seconds",
    "max_junction_s",
    type=click.FloatRange(min=0.0, min_open=True),
    default=300.0,
    metavar="SECONDS",
    is_common=False,
    expected="seconds, more than 0",
    help="For each junction, all in all; --time-limit is the optimiser's part of it.",
)
@options.option(
    "--radius",
    "radius_m",
    type=click.FloatRange(min=0.0, min_open=True),
    default=80.0,
    metavar="METRES",
    is_common=False,
    expected="metres, more than 0",
    help="Around a junction; things farther away are left out.",
)
@options.option(
    "--sites",
    default="auto",
    metavar="WHERE",
    help=(
        "map, kerb:15, or a list, as in `scene import`; auto: map, but for low sign "
        "posts and poles of other junctions, and kerb:15 where none is within 25 m."
    ),
)
@sites_crs_option
@options.option(
    "--worker-memory",
    default="1.5GiB",
    metavar="SIZE",
    is_common=False,
    help=(
        "Of each process on this machine, where there are several; one that takes more "
        "is ended, and its junction tried again."
    ),
)
@options.engine_options
@partial(reading_options, staggered_m=_STAGGERED_M)
@options.asking(
    *_MOUNTED,
    *_SOUGHT,
    *_DRIVEN,
    defaults={"time_limit_s": _TIME_LIMIT_S},
    has_cache=False,
)
def city(
    job: QuestionCall,
    /,
    *,
    maps: tuple[Path, ...],
    out: Path,
    worker_memory: str,
    engine: dict[str, Any],
    **given: Any,
) -> None:
    """Choose units for the junctions of a city under one budget.

    Each junction of the maps is cut out, and its front is found: what each number of
    units, and each sum of money, buys there. One exact choice over all fronts says who
    gets what; the folder has a report with a map, what to order, and every junction's
    own scene and page.
    """
    if given["budget_units"] is None and given["budget_eur"] is None:
        raise click.UsageError(
            "--budget: got nothing; expected a whole number of units, at least 0, or"
            " --budget-eur"
        )
    job.start()
    from ..engine.start import EngineWish, memory_bytes
    from .inputs import CitySearch, CityWish
    from .run import run_city

    result = run_city(
        job.question,
        maps=maps,
        wish=CityWish(**_of(CityWish, given)),
        search=CitySearch(**_of(CitySearch, given), gap=job.question.gap),
        engine=EngineWish(
            workers=job.compute.workers,
            max_bytes=memory_bytes(worker_memory),
            **engine,
        ),
        out=out,
        seed=job.compute.seed,
        command=command_line(),
        progress=job.progress,
        tell=job.announce,
    )
    job.print(result, lambda: city_text(result, out))


def _of(kind: Any, given: dict[str, Any]) -> dict[str, Any]:
    """Options that are called as the fields of a dataclass."""
    return {
        field.name: given[field.name] for field in fields(kind) if field.name in given
    }


def city_text(result: "CityResult", out: Path) -> str:
    """A city's answer for the terminal.

    Sentences, units by junction, junctions not done.
    """
    served = sorted(
        (one for one in result.junctions if one.units), key=lambda one: -one.gain
    )
    failed = [one for one in result.junctions if one.reason]
    lines = sentences(*result.sentences)
    rows = [
        [
            one.label,
            str(one.units),
            localized(f"{one.cost_eur:,.0f}"),
            percent(one.apr),
            percent(one.gain),
        ]
        for one in served[:_MAX_LISTED]
    ]
    if served:
        heads = [
            tr("junction"),
            tr("sensors"),
            "EUR",
            tr("prevented"),
            tr("of the city"),
        ]
        lines += ["", *table(heads, rows)]
        lines += _more(len(served))
    if failed:
        lines += ["", tr("Left out:")]
        for one in failed[:_MAX_LISTED]:
            lines += sentences(f"{one.label}: {one.why}", indent=2, hanging=2)
        lines += _more(len(failed))
    weights = tr("Weights: {source}.", source=result.weights)
    lines += ["", *sentences(weights, *result.notes, *result.warnings)]
    written = tr(
        "Written to {folder}: report.html, city.gpkg, poles.csv and more.", folder=out
    )
    return "\n".join([*lines, written])


def _more(n: int) -> list[str]:
    left = n - _MAX_LISTED
    if left > 0:
        return ["  " + tr("and {n} more: junctions.csv", n=left)]
    return []
