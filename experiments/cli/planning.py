"""Options that say what is asked of a layout, and how it is looked for."""

from collections.abc import Callable
from typing import Any

import click

from placement.question import Question

from .options import (
    Number,
    OneOf,
    Share,
    WholeNumber,
    complete_paths,
    no_look_option,
)

FUSIONS = ("any", "single")
SOLVERS = ("auto", "exact", "relax", "greedy")
Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

_ASKED = (
    click.option(
        "--budget", type=WholeNumber(1, "a whole number of units"), help="Most units to mount."
    ),
    click.option(
        "--budget-cost",
        type=Number("EUR", "euros"),
        help="Most money to spend on units and sites.",
    ),
    click.option(
        "--target",
        default="",
        metavar="SHARE",
        help="APR to be reached with the fewest units: 0.99, or max for all that can be reached.",
    ),
    click.option(
        "--least",
        type=OneOf(("units", "cost")),
        default="units",
        show_default=True,
        help="What --target is reached with the least of.",
    ),
    click.option(
        "--min-case-apr",
        type=Share("a share of the runs"),
        default=0.0,
        help="APR that must be reached in every case.",
    ),
    click.option(
        "--survive",
        type=WholeNumber(0, "units that may fail, 0 to 2"),
        default=0,
        help="Reach --target and --min-case-apr even when any N units fail; without these, look "
        "for the highest APR that is left then.",
    ),
)
_SITES = (
    click.option(
        "--keep",
        default="",
        metavar="LAYOUT",
        shell_complete=complete_paths,
        help="A layout that hangs there and is paid: units are added to it.",
    ),
    click.option(
        "--within",
        default="",
        metavar="LAYOUT",
        shell_complete=complete_paths,
        help="Choose among the units of this layout alone: carlancap-12, or a file.",
    ),
    click.option("--force-site", default="", metavar="SITES", help="Sites that must carry units."),
    click.option(
        "--forbid-site", default="", metavar="SITES", help="Sites that must not carry any."
    ),
    click.option(
        "--site-capacity",
        type=WholeNumber(1, "units per site"),
        help="Units that each site can carry; default: the scene's.",
    ),
    click.option(
        "--site-cost",
        "site_cost_eur",
        type=Number("EUR", "euros", may_be_zero=True),
        help="Of each site that is used, once; default: the scene's.",
    ),
    click.option(
        "--separation",
        "separation_m",
        type=Number("METRES", "metres", may_be_zero=True),
        default=0.0,
        help="Least distance between two units on the ground; one per site then.",
    ),
    click.option(
        "--sensors",
        default="",
        metavar="NAMES",
        help="Models to choose from, with commas between: carla-ncap-rgb,carla-ncap-lidar, or "
        "your own: FILE.toml, FILE.toml:NAME; default: the study's camera.",
    ),
    no_look_option("Areas that no camera may have in its picture"),
    click.option(
        "--no-look-share",
        type=Share("a share of an area"),
        help="Share of such an area that may be in the picture all the same; default: none.",
    ),
    click.option(
        "--no-look-price",
        type=Number("EUR", "euros", may_be_zero=True),
        default=0.0,
        help="In place of forbidding: what each square metre in a camera's picture costs, beside "
        "the sensor; counts in --budget-cost, --least cost and the last objective.",
    ),
    click.option(
        "--study-poses/--no-study-poses",
        default=True,
        show_default=True,
        help="Whether the study's own 12 poses are candidates too.",
    ),
)
_LOOKING = (
    click.option(
        "--fusion",
        type=OneOf(FUSIONS),
        default="any",
        show_default=True,
        help="any: a frame counts if any unit detects; single: one unit must confirm alone.",
    ),
    click.option(
        "--stage-weights",
        default="",
        metavar="WEIGHTS",
        help="One weighted sum in place of the objectives in order: apr=1,mean_margin_s=0.1.",
    ),
    click.option(
        "--solver",
        type=OneOf(SOLVERS),
        default="auto",
        show_default=True,
        help="greedy: search only; relax: bounds of relaxations; exact: models and enumeration "
        "to the end; auto: what the size allows.",
    ),
    click.option(
        "--milp-solver",
        default="HIGHS",
        show_default=True,
        metavar="NAME",
        help="Mixed-integer solver, by its name in cvxpy: HIGHS, SCIP, CBC, GUROBI, ..",
    ),
    click.option(
        "--time-limit",
        "time_limit_s",
        type=Number("SECONDS", "seconds"),
        default=20.0,
        show_default=True,
        help="For the optimiser; when it is up, the best layout found and its gap are given.",
    ),
    click.option(
        "--gap",
        type=Share("a relative gap"),
        default=0.0,
        help="Relative gap at which an objective counts as settled.",
    ),
)
_REFINING = click.option(
    "--refine/--no-refine",
    default=False,
    show_default=True,
    help="Look between the poses of the grid, too: turn, tilt, raise and zoom the units found; up "
    "to a minute more.",
)
_SAMPLING = (
    click.option(
        "--samples",
        type=WholeNumber(0, "a number of sampled worlds"),
        default=0,
        help="Choose for so many worlds with mounting errors, traffic, misses and lost messages "
        "drawn at random; each needs a detection table of its own.",
    ),
    click.option(
        "--uncertainty",
        default="default",
        show_default=True,
        metavar="NAME",
        help="What is drawn: a name, or a .toml file.",
    ),
    click.option(
        "--risk",
        default="mean",
        show_default=True,
        metavar="HOW",
        help="With --samples: mean, worst, or the share of the worst worlds whose mean APR counts.",
    ),
)
_POOL = (
    click.option(
        "--pool",
        type=WholeNumber(0, "a number of layouts"),
        default=0,
        help="List so many layouts that are as good in the first objective, the best first, and "
        "how often each site appears in them.",
    ),
    click.option(
        "--pool-tolerance",
        type=Share("a share"),
        default=0.0,
        help="How much worse the layouts of --pool may be: a share of the runs, or of the units "
        "or the cost that a target needs.",
    ),
)


def planning_options(*, has_samples: bool = True) -> Decorator:
    """Options of a command that plans; beside `question_options`, they become one `question`.

    Parameters
    ----------
    has_samples : bool
        Whether it can choose for sampled worlds, refine what it chose, and list what is as good.
    """
    more = (_REFINING, *_SAMPLING, *_POOL) if has_samples else ()
    options = (*_ASKED, *_SITES, *_LOOKING, *more)

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


def check_asked(question: Question) -> None:
    """Refuse to plan for nothing.

    Raises
    ------
    click.UsageError
        Neither units nor money nor a target is given.
    """
    if question.budget is None and question.budget_cost is None and not question.target:
        raise click.UsageError(
            "--budget: got nothing; expected a whole number of units, at least 1 (or --target, or "
            "--budget-cost)"
        )
