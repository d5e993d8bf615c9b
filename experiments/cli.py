"""``place-rsus``: parse, only then import what is heavy, call, print. The only file that prints."""

import json
import logging
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from geometry.errors import InputError, Unquoted

if TYPE_CHECKING:
    from placement.layout import Layout

    from .progress import StageProgress

FUSIONS = ("any", "single")
EXPORT_FORMATS = ("csv", "geojson", "carla")
DEFAULT_OUT = Path("results/latest")
_BASELINE = "carlancap-12"
_EXIT_BAD_INPUT = 2
_EXIT_INTERRUPTED = 130


class _OneOf(click.ParamType[str]):
    """A word from a list; another one is told in this project's words."""

    name = "name"

    def __init__(self, words: Sequence[str]) -> None:
        self.words = words

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        return "[" + "|".join(self.words) + "]"

    def convert(self, value: str, param: Any, ctx: Any) -> str:
        if value not in self.words:
            raise InputError(_option(param), value, "one of " + ", ".join(self.words))
        return value


class _WholeNumber(click.ParamType[int]):
    """A whole number from a least value on."""

    name = "number"

    def __init__(self, least: int, what: str) -> None:
        self.least = least
        self.what = what

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        return "N"

    def convert(self, value: Any, param: Any, ctx: Any) -> int:
        try:
            number = int(value)
        except ValueError:
            number = self.least - 1
        if number < self.least:
            raise InputError(_option(param), value, f"{self.what}, at least {self.least}")
        return number


class _Seconds(click.ParamType[float]):
    """A positive time."""

    name = "seconds"

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        return "SECONDS"

    def convert(self, value: Any, param: Any, ctx: Any) -> float:
        try:
            seconds = float(value)
        except ValueError:
            seconds = 0.0
        if not 0.0 < seconds < float("inf"):
            raise InputError(_option(param), value, "seconds, more than 0")
        return seconds


def _option(param: click.Parameter) -> str:
    return max(param.opts, key=len)


_json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object on stdout and nothing else."
)
_quiet_option = click.option("--quiet", is_flag=True, help="No progress on stderr.")
_workers_option = click.option(
    "--workers",
    type=_WholeNumber(1, "a number of threads"),
    default=os.cpu_count() or 1,
    show_default="one per processor",
    help="Threads.",
)


@click.group(
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="""\b
Examples:
  place-rsus --budget 3                            the best three cameras
  place-rsus --budget 2 --fusion single            each must confirm by itself
  place-rsus --budget 3 --json --quiet | jq .apr   for a machine
  place-rsus evaluate --layout carlancap-12        the study's 12 cameras
  place-rsus compare --layout results/latest/layout.json --layout carlancap-12
  place-rsus export --layout results/latest/layout.json --format carla

Exit codes: 0 done, 2 the input is wrong (one line says what), 130 interrupted.""",
)
@click.version_option(package_name="place-rsus")
@click.option(
    "--budget", type=_WholeNumber(1, "a whole number of units"), help="How many units to mount."
)
@click.option(
    "--fusion",
    type=_OneOf(FUSIONS),
    default="any",
    show_default=True,
    help="any: a frame counts if any unit detects; single: one unit must confirm alone.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=DEFAULT_OUT,
    show_default=True,
    help="Folder for report, layout, tables and figures; earlier results there are replaced.",
)
@_json_option
@_quiet_option
@click.option(
    "--seed",
    type=_WholeNumber(0, "a whole number"),
    default=0,
    show_default=True,
    help="Of the points spread over the road users.",
)
@_workers_option
@click.option(
    "--study-poses/--no-study-poses",
    default=True,
    show_default=True,
    help="Whether the study's own 12 poses are candidates too.",
)
@click.option(
    "--time-limit",
    type=_Seconds(),
    default=60.0,
    show_default=True,
    help="For the optimiser; when it is up, the best layout found and its gap are given.",
)
@click.option(
    "--cache/--no-cache",
    "uses_cache",
    default=True,
    show_default=True,
    help="Keep detection tables between calls, in PLACE_RSUS_CACHE or the user's cache folder.",
)
@click.pass_context
def cli(
    context: click.Context,
    *,
    budget: int | None,
    fusion: str,
    out: Path,
    as_json: bool,
    quiet: bool,
    seed: int,
    workers: int,
    study_poses: bool,
    time_limit: float,
    uses_cache: bool,
) -> None:
    """Where to mount roadside cameras so that pedestrians and cyclists are not hit.

    Finds the best layout for the junction of the CarlaNCAP study, proves that it is, evaluates it
    by full perception and emergency braking, compares it with the study's 12 cameras, and writes
    a report.
    """
    if context.invoked_subcommand is not None:
        given = [
            _option(param)
            for param in context.command.params
            if context.get_parameter_source(str(param.name)) is click.core.ParameterSource.COMMANDLINE
        ]
        if given:
            raise InputError(
                given[0],
                Unquoted(f"it before {context.invoked_subcommand}"),
                f"options of {context.invoked_subcommand} behind its name",
            )
        return
    if budget is None:
        raise InputError("--budget", Unquoted("nothing"), "a whole number of units, at least 1")
    from . import jobs

    with _progress(quiet=quiet or as_json, keeps=f"nothing was written to {out}") as progress:
        summary = jobs.run_placement(
            budget_units=budget,
            fusion=fusion,
            out=out,
            seed=seed,
            workers=workers,
            includes_study_poses=study_poses,
            time_limit_s=time_limit,
            cache_folder=_cache_folder() if uses_cache else None,
            command=_command_line(),
            progress=progress,
        )
    _print(summary, as_json, lambda: _placement_text(summary, out))


@cli.command()
@click.option("--layout", "layout_name", required=True, help="carlancap-12, or a layout file.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for a report; else none.")
@_json_option
@_quiet_option
@_workers_option
def evaluate(
    *, layout_name: str, out: Path | None, as_json: bool, quiet: bool, workers: int
) -> None:
    """Evaluate a layout by full perception and emergency braking.

    \b
    Examples:
      place-rsus evaluate --layout carlancap-12
      place-rsus evaluate --layout results/latest/layout.json --out results/mine
    """
    from . import jobs

    with _progress(quiet=quiet or as_json, keeps="nothing was written") as progress:
        summary = jobs.run_evaluation(
            layout=_load_layout(layout_name),
            out=out,
            workers=workers,
            command=_command_line(),
            progress=progress,
        )
    _print(summary, as_json, lambda: _evaluation_text(summary, out))


@cli.command()
@click.option(
    "--layout", "layout_names", multiple=True, help="carlancap-12, or a layout file; give two."
)
@click.option("--out", type=click.Path(path_type=Path), help="Folder for a report; else none.")
@_json_option
@_quiet_option
@_workers_option
def compare(
    *, layout_names: tuple[str, ...], out: Path | None, as_json: bool, quiet: bool, workers: int
) -> None:
    """Compare two layouts on the same runs; the second is the baseline.

    \b
    Example:
      place-rsus compare --layout results/latest/layout.json --layout carlancap-12
    """
    if len(layout_names) != 2:
        raise InputError("--layout", Unquoted(f"{len(layout_names)} layouts"), "it twice")
    from . import jobs

    with _progress(quiet=quiet or as_json, keeps="nothing was written") as progress:
        summary = jobs.run_comparison(
            subject=_load_layout(layout_names[0]),
            baseline=_load_layout(layout_names[1]),
            out=out,
            workers=workers,
            command=_command_line(),
            progress=progress,
        )
    _print(summary, as_json, lambda: _comparison_text(summary, out))


@cli.command()
@click.option("--layout", "layout_name", required=True, help="carlancap-12, or a layout file.")
@click.option(
    "--format",
    "format_name",
    required=True,
    type=_OneOf(EXPORT_FORMATS),
    help="csv; geojson (WGS 84); carla: spawn transforms in CARLA's frame.",
)
@click.option("--out", type=click.Path(path_type=Path), help="File to write; else stdout.")
def export(*, layout_name: str, format_name: str, out: Path | None) -> None:
    """Write a layout in a format that other programs read.

    \b
    Examples:
      place-rsus export --layout carlancap-12 --format carla
      place-rsus export --layout results/latest/layout.json --format geojson --out rsus.geojson
    """
    from . import jobs

    text = jobs.export_layout(_load_layout(layout_name), format_name)
    if out is None:
        click.echo(text, nl=False)
        return
    from geometry.atomic_files import write_atomically

    try:
        write_atomically(out, lambda file: file.write(text.encode()))
    except OSError as error:
        raise InputError(
            "--out", Unquoted(f"{out}: {error.strerror}"), "a file that can be written"
        ) from None


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line; every problem that the user can mend is one line and exit code 2."""
    logging.basicConfig(stream=sys.stderr, format="place-rsus: %(message)s")
    try:
        cli.main(args=arguments, prog_name="place-rsus", standalone_mode=False)
    except InputError as error:
        _fail(str(error), _EXIT_BAD_INPUT)
    except click.ClickException as error:
        _fail(" ".join(error.format_message().split()), _EXIT_BAD_INPUT)
    except (KeyboardInterrupt, click.Abort) as error:
        note = getattr(error, "__notes__", ["nothing was written"])[-1]
        _fail(f"interrupted: {note}", _EXIT_INTERRUPTED)
    except BrokenPipeError:
        # The reader of stdout has gone; Python must not try to flush what it no longer takes.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(0)


def _fail(message: str, code: int) -> NoReturn:
    sys.stderr.write(f"place-rsus: {message}\n")
    sys.exit(code)


class _progress:  # noqa: N801 - used as a function
    """Progress whose interruption says in which stage, and what was kept."""

    def __init__(self, *, quiet: bool, keeps: str) -> None:
        self._quiet = quiet
        self._keeps = keeps

    def __enter__(self) -> "StageProgress":
        from geometry.raycast import open3d_problem

        from .progress import StageProgress

        problem = open3d_problem()
        if problem is not None:
            logging.getLogger(__name__).warning("%s", problem)
        self._progress = StageProgress(quiet=self._quiet)
        return self._progress.__enter__()

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        self._progress.__exit__(kind, error, trace)
        if isinstance(error, KeyboardInterrupt):
            kept = (
                "; the detection table is kept for the next call"
                if any(stage.startswith("optimise") for stage in self._progress.seconds)
                else ""
            )
            error.add_note(f"in stage '{self._progress.stage}', {self._keeps}{kept}")


def _cache_folder() -> Path:
    folder = os.environ.get("PLACE_RSUS_CACHE")
    if folder:
        return Path(folder)
    from platformdirs import user_cache_path

    return user_cache_path("place-rsus")


def _command_line() -> str:
    import shlex

    return shlex.join(["place-rsus", *sys.argv[1:]])


def _load_layout(name: str) -> "Layout":
    from placement.layout import load_layout

    from .study import load_carlancap_layout

    if name == _BASELINE:
        return load_carlancap_layout()
    path = Path(name)
    if not path.exists():
        raise InputError("--layout", name, f"{_BASELINE}, or a layout file that exists")
    return load_layout(path)


def _print(summary: dict[str, Any], as_json: bool, text: Callable[[], str]) -> None:
    click.echo(json.dumps(summary, allow_nan=False, indent=2) if as_json else text())


def _percent(ratio: float) -> str:
    return f"{100.0 * ratio:6.1f} %"


def _units_text(units: list[dict[str, Any]]) -> list[str]:
    rows = [f"  {'unit':<6} {'site':<11} {'x m':>8} {'y m':>8} {'z m':>6} {'yaw':>7} {'pitch':>7}"]
    rows += [
        f"  {unit['id']:<6} {unit['site'] or '-':<11} {unit['x_m']:8.2f} {unit['y_m']:8.2f} "
        f"{unit['z_m']:6.2f} {unit['yaw_deg']:7.1f} {unit['pitch_deg']:7.1f}"
        for unit in units
    ]
    return rows


def _apr_text(columns: dict[str, dict[str, Any]]) -> list[str]:
    cases = next(iter(columns.values()))["by_case"]
    rows = [f"  {'APR':<22} {'all':>8} " + "".join(f"{case:>9} " for case in cases)]
    rows += [
        f"  {name:<22} {_percent(value['all'])} "
        + " ".join(f" {_percent(value['by_case'][case])}" for case in cases)
        for name, value in columns.items()
    ]
    return rows


def _placement_text(summary: dict[str, Any], out: Path) -> str:
    stages = {stage["name"]: stage for stage in summary["stages"]}
    names = {
        "apr": ("accidents prevented", _percent),
        "apr_one_failed": ("if the worst one fails", _percent),
        "smallest_margin_s": ("smallest margin", lambda value: f"{value:6.3f} s"),
        "mean_margin_s": ("mean margin", lambda value: f"{value:6.3f} s"),
    }
    evaluation, baseline = summary["evaluation"], summary["baseline"]
    lines = [
        f"Best {len(summary['layout'])} of {summary['candidates']} poses on {summary['runs']} runs "
        f"(fusion {summary['fusion']}):",
        *_units_text(summary["layout"]),
        "",
        f"  {'on the detection table':<24} {'found':>9} {'bound':>9} {'gap':>8}",
    ]
    for key, (words, show) in names.items():
        stage = stages[key]
        gap = "proven" if stage["gap"] == 0.0 else f"{100.0 * stage['gap']:.2f} %"
        lines.append(
            f"  {words:<24} {show(stage['objective']):>9} {show(stage['bound']):>9} {gap:>8}"
        )
    lines += [
        "",
        "Evaluated by full perception and emergency braking:",
        *_apr_text(
            {
                "these units, fused": evaluation["rsu_all"],
                "  and the VUT's camera": evaluation["vut_and_rsus"],
                "  the VUT's camera only": evaluation["vut"],
                "greedy, same number": summary["greedy"]["rsu_all"],
                f"{_BASELINE}, fused": baseline["rsu_all"],
            }
        ),
        "",
        f"Table and evaluator disagree on {_percent(summary['surrogate_disagreement']).strip()} "
        "of the runs.",
        f"Written to {out}: report.html and more.",
    ]
    return "\n".join(lines)


def _evaluation_text(summary: dict[str, Any], out: Path | None) -> str:
    evaluation = summary["evaluation"]
    lines = [
        f"{summary['name']} on {summary['runs']} runs:",
        *_units_text(summary["layout"]),
        "",
        *_apr_text(
            {
                **evaluation["units"],
                "all units, fused": evaluation["rsu_all"],
                "  and the VUT's camera": evaluation["vut_and_rsus"],
                "the VUT's camera only": evaluation["vut"],
            }
        ),
    ]
    if out is not None:
        lines += ["", f"Written to {out}: report.html and more."]
    return "\n".join(lines)


def _comparison_text(summary: dict[str, Any], out: Path | None) -> str:
    evaluation, baseline = summary["evaluation"], summary["baseline"]
    lines = [
        f"{summary['name']} against {summary['baseline_name']} on {summary['runs']} runs:",
        *_apr_text(
            {
                f"{summary['name']}"[:22]: evaluation["rsu_all"],
                "  and the VUT's camera": evaluation["vut_and_rsus"],
                f"{summary['baseline_name']}"[:22]: baseline["rsu_all"],
                "  with the VUT's camera": baseline["vut_and_rsus"],
                "the VUT's camera only": evaluation["vut"],
            }
        ),
        f"  runs gained: {', '.join(summary['runs_gained']) or 'none'}",
        f"  runs lost:   {', '.join(summary['runs_lost']) or 'none'}",
    ]
    if out is not None:
        lines += ["", f"Written to {out}: report.html and more."]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
