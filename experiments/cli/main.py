"""``place-rsus``: parse, only then import what is heavy, call, print. The only file that prints."""

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import click
from click.shell_completion import get_completion_class

from placement.question import Question

from ..progress import (
    Interrupted,
    StageProgress,
    StderrLog,
    cache_folder,
    command_line,
    ending_on_signals,
    load_one_layout,
    print_result,
    warn_of_slow_rays,
)
from ..results import text
from .compare import compare
from .doctor import doctor
from .export import export
from .latency import latency, latency_budget_options
from .options import (
    SectionedCommand,
    SectionedGroup,
    cache_option,
    json_option,
    layout_option,
    no_look_option,
    option_name,
    question_options,
    quiet_option,
    seed_option,
    workers_option,
)
from .pareto import pareto
from .planning import check_asked, planning_options
from .recording import check_recording_options, is_given, recording_options
from .render import render
from .retrofit import retrofit
from .scenarios import scenarios
from .scene import scene
from .sheet import sheet
from .solve import solve
from .tables import recorded_placement_table, recording_table
from .verify import verify

# ---------- ``place-rsus help`` and ``place-rsus completion``


_SHELLS = ("bash", "zsh", "fish")
_COMPLETE_VARIABLE = "_PLACE_RSUS_COMPLETE"


@click.command(
    epilog="""\b
Examples:
  place-rsus help                  the main command
  place-rsus help scene import     one further down"""
)
@click.argument("names", nargs=-1, metavar="[COMMAND]...")
@click.pass_context
def help_command(context: click.Context, *, names: tuple[str, ...]) -> None:
    """Show the help of a command, page by page on a terminal."""
    at = context.find_root()
    command = at.command
    for name in names:
        inner = command.get_command(at, name) if isinstance(command, click.Group) else None
        if inner is None:
            known = sorted(command.commands) if isinstance(command, click.Group) else []
            raise click.UsageError(
                f"help: got '{' '.join(names)}'; expected "
                + (f"one of {', '.join(known)}" if known else f"nothing behind {at.info_name}")
            )
        at = click.Context(inner, parent=at, info_name=name)
        command = inner
    click.echo_via_pager(command.get_help(at) + "\n")


@click.command(
    epilog="""\b
Examples:
  eval "$(place-rsus completion bash)"                      in ~/.bashrc
  eval "$(place-rsus completion zsh)"                       in ~/.zshrc
  place-rsus completion fish > ~/.config/fish/completions/place-rsus.fish"""
)
@click.argument("shell", type=click.Choice(_SHELLS))
@click.pass_context
def completion(context: click.Context, *, shell: str) -> None:
    """Print what makes a shell complete commands, options and their words."""
    root = context.find_root()
    script = get_completion_class(shell)
    assert script is not None  # click has all three
    click.echo(script(root.command, {}, "place-rsus", _COMPLETE_VARIABLE).source())


# ---------- ``place-rsus``


DEFAULT_OUT = Path("results/latest")
_EXIT_BAD_INPUT = 2


@click.group(
    cls=SectionedGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="""\b
Examples:
  place-rsus --budget 3                            the best three cameras
  place-rsus --target 0.99 --least cost            the cheapest way to 99 %
  place-rsus --budget 3 --within carlancap-12      three of the study's own
  place-rsus --budget-cost 9000 --site-cost 2000   the best for the money
  place-rsus --budget 2 --fusion single            each must confirm alone
  place-rsus --budget 3 --json --quiet | jq .apr   for a machine
  place-rsus --budget 3 --cases protocol-4.5.1 --weights case
  place-rsus --budget 3 --cases CPNCO-50,CBNA --speeds 40-60
  place-rsus --budget 3 --weather day,night,fog --detector response
  place-rsus scenarios list                        what can be driven here
  place-rsus evaluate --layout carlancap-12        the study's 12 cameras
  place-rsus --budget 3 --recording ncap_data      the best recorded units
  place-rsus compare results/latest/layout.json carlancap-12
  place-rsus scene import city.osm -o scene        your own junction ..
  place-rsus --scene scene --budget 3              .. and the best three there
  place-rsus pareto --max 8                        what each further unit buys
  place-rsus retrofit --layout carlancap-12        remove, re-aim or add
  place-rsus sheet --layout results/latest/layout.json --out mounting.pdf
  place-rsus verify results/latest                 check a certificate
  place-rsus doctor                                what is installed here
  place-rsus export --layout results/latest/layout.json --format carla

Exit codes: 0 done, 1 `verify`, `scene check` or `doctor` found a fault, 2 the input is wrong or
cannot be met (one line says what), 130 interrupted, 143 terminated.""",
)
@click.version_option(package_name="place-rsus")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=DEFAULT_OUT,
    show_default=True,
    help="Folder for report, layout, tables and figures; earlier results there are replaced.",
)
@recording_options
@planning_options()
@question_options()
@latency_budget_options()
@json_option
@quiet_option
@seed_option
@workers_option
@cache_option
@click.pass_context
def cli(
    context: click.Context,
    *,
    recording: Path | None,
    min_confidence: float,
    question: Question,
    out: Path,
    as_json: bool,
    quiet: bool,
    seed: int,
    workers: int,
    uses_cache: bool,
) -> None:
    """Where to mount roadside cameras so that pedestrians and cyclists are not hit.

    Finds the best layout for the junction of the CarlaNCAP study, proves that it is, evaluates it
    by full perception and emergency braking, compares it with the study's 12 cameras, and writes
    a report.
    """
    if context.invoked_subcommand is not None:
        given = [
            option_name(param)
            for param in context.command.params
            if context.get_parameter_source(str(param.name))
            is click.core.ParameterSource.COMMANDLINE
        ]
        if given:
            raise click.UsageError(
                f"{given[0]}: options of {context.invoked_subcommand} go behind its name"
            )
        return
    check_asked(question)
    progress: StageProgress = context.obj
    check_recording_options(recording)
    if recording is not None:
        progress.start(quiet=quiet)
        from ..jobs import recording as recording_job

        folder = out if is_given("out") else None
        summary = recording_job.run_recorded_placement(
            question,
            folder=recording,
            min_confidence=min_confidence,
            out=folder,
            progress=progress,
        )
        print_result(summary, progress, as_json, lambda: recorded_placement_table(summary, folder))
        return
    placement = _start(progress, quiet=quiet)
    result = placement.run_placement(
        question,
        out=out,
        seed=seed,
        workers=workers,
        cache_folder=cache_folder() if uses_cache else None,
        command=command_line(),
        progress=progress,
    )
    from ..results.record import to_plain
    from .tables import with_additions

    summary = to_plain(result)  # border
    print_result(
        summary,
        progress,
        as_json,
        lambda: with_additions(summary, text.placement_table(summary, out)),
    )


@cli.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus evaluate --layout carlancap-12
  place-rsus evaluate --layout results/latest/layout.json --out results/mine
  place-rsus evaluate --recording ncap_data""",
)
@layout_option
@no_look_option("Areas of which the share is told that each camera has in its picture")
@recording_options
@click.option("--out", type=click.Path(path_type=Path), help="Folder for a report; else none.")
@question_options()
@latency_budget_options()
@json_option
@quiet_option
@seed_option
@workers_option
@click.pass_obj
def evaluate(
    progress: StageProgress,
    *,
    layout_names: tuple[str, ...],
    no_look: str,
    recording: Path | None,
    min_confidence: float,
    out: Path | None,
    question: Question,
    as_json: bool,
    quiet: bool,
    seed: int,
    workers: int,
) -> None:
    """Evaluate a layout by full perception and emergency braking, or recorded detections."""
    check_recording_options(recording)
    if recording is not None:
        progress.start(quiet=quiet)
        from ..jobs import recording as recording_job

        summary = recording_job.run_recording(
            question,
            folder=recording,
            min_confidence=min_confidence,
            out=out,
            progress=progress,
        )
        print_result(summary, progress, as_json, lambda: recording_table(summary, out))
        return
    layout = load_one_layout(layout_names)
    placement = _start(progress, quiet=quiet)
    result = placement.run_evaluation(
        question,
        layout=layout,
        no_look=no_look,
        out=out,
        seed=seed,
        workers=workers,
        command=command_line(),
        progress=progress,
    )
    from ..results.record import to_plain
    from .tables import with_additions

    summary = to_plain(result)  # border
    print_result(
        summary,
        progress,
        as_json,
        lambda: with_additions(summary, text.evaluation_table(summary, out)),
    )


cli.add_command(compare)
cli.add_command(completion)
cli.add_command(doctor)
cli.add_command(export)
cli.add_command(help_command, "help")
cli.add_command(latency)
cli.add_command(pareto)
cli.add_command(render)
cli.add_command(retrofit)
cli.add_command(scenarios)
cli.add_command(scene)
cli.add_command(sheet)
cli.add_command(solve)
cli.add_command(verify)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line; every problem that the user can mend is one line and exit code 2."""
    logging.basicConfig(handlers=[StderrLog()], format="place-rsus: %(message)s")
    progress = StageProgress()
    code, message = 0, ""
    try:
        with ending_on_signals(progress):
            cli.main(args=arguments, prog_name="place-rsus", standalone_mode=False, obj=progress)
    except Interrupted as error:
        code, message = 128 + error.signum, progress.interruption()
    except _mendable_errors() as error:
        code, message = _EXIT_BAD_INPUT, f"place-rsus: {error}"
    except click.ClickException as error:
        text = " ".join(error.format_message().split())
        code, message = _EXIT_BAD_INPUT, f"place-rsus: {text}"
    except OSError as error:  # such as a disk that is full
        where = f"{error.filename}: " if error.filename else ""
        code, message = _EXIT_BAD_INPUT, f"place-rsus: {where}{error.strerror or error}"
    finally:
        progress.stop()
    if message:
        click.echo(message, err=True)
    sys.exit(code)


def _mendable_errors() -> tuple[type[Exception], ...]:
    from geometry.errors import InputError, MissingExtraError

    return InputError, MissingExtraError


def _start(progress: StageProgress, *, quiet: bool) -> Any:
    """Show what happens from here on; import what does the work."""
    progress.start(quiet=quiet)
    warn_of_slow_rays()
    from ..jobs import placement

    return placement


if __name__ == "__main__":
    main()
