"""``place-rsus city``: units for the junctions of a city under one budget."""

from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..cli import options
from ..cli.running import Job, command_line
from ..cli.terminal import sentences, table
from ..language import localized, tr
from ..results.numbers import percent
from ..scene.command import reading_options

if TYPE_CHECKING:
    from .answer import CityResult

_MOUNTED = ("site_capacity", "site_cost_eur", "separation_m", "sensors")
_SOUGHT = ("solver", "time_limit_s", "gap", "fusion")
_TIME_LIMIT_S = 30.0  # for the optimiser at each junction
_DRIVEN = tuple(
    name
    for name in options.JUDGED
    # Accidents count around each junction; --near is about areas here.
    if name not in (*options.OF_SCENE, "near", "vut_sensors", "packet_loss", "vam_rate", "strict")
)
_MAX_LISTED = 12
_STAGGERED_M = 40.0  # a driver crosses both side roads in one go


@click.command(cls=options.SectionedCommand, epilog=options.EXAMPLES["city"])
@click.argument("maps", nargs=-1, required=True, metavar="MAP...", type=click.Path(path_type=Path))
@options.from_table("city")
@partial(reading_options, staggered_m=_STAGGERED_M)
@options.asking(
    *_MOUNTED,
    *_SOUGHT,
    *_DRIVEN,
    defaults={"time_limit_s": _TIME_LIMIT_S},
    has_cache=False,
)
def city(
    job: Job, /, *, maps: tuple[Path, ...], out: Path, worker_memory: str, **given: Any
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
    job.start()
    from .inputs import CitySearch, CityWish
    from .run import run_city

    result = run_city(
        job.question,
        maps=maps,
        wish=CityWish(**_of(CityWish, given)),
        search=CitySearch(**_of(CitySearch, given), gap=job.question.gap),
        n_workers=job.compute.workers,
        memory=worker_memory,
        out=out,
        seed=job.compute.seed,
        command=command_line(),
        progress=job.progress,
        tell=job.announce,
    )
    job.print(result, lambda: city_text(result, out))


def _of(kind: Any, given: dict[str, Any]) -> dict[str, Any]:
    """Options that are called as the fields of a dataclass."""
    return {field.name: given[field.name] for field in fields(kind) if field.name in given}


def city_text(result: "CityResult", out: Path) -> str:
    """A city's answer for the terminal: sentences, units by junction, junctions not done."""
    served = sorted((one for one in result.junctions if one.units), key=lambda one: -one.gain)
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
        heads = [tr("junction"), tr("sensors"), "EUR", tr("prevented"), tr("of the city")]
        lines += ["", *table(heads, rows)]
        lines += _more(len(served))
    if failed:
        lines += ["", tr("Left out:")]
        for one in failed[:_MAX_LISTED]:
            lines += sentences(f"{one.label}: {one.why}", indent=2, hanging=2)
        lines += _more(len(failed))
    weights = tr("Weights: {source}.", source=result.weights)
    lines += ["", *sentences(weights, *result.notes, *result.warnings)]
    written = tr("Written to {folder}: report.html, city.gpkg, poles.csv and more.", folder=out)
    return "\n".join([*lines, written])


def _more(n: int) -> list[str]:
    left = n - _MAX_LISTED
    return ["  " + tr("and {n} more: junctions.csv", n=left)] if left > 0 else []
