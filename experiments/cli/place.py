"""``place-rsus``: the best layout, proven, evaluated, compared with the study's, reported."""

from pathlib import Path

import click

from ..language import mark
from . import options
from .recording import evaluate_recording
from .running import Job, command_line


@click.group(
    cls=options.SectionedGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=options.EXAMPLES["place"],
)
@click.version_option(package_name="place-rsus")
@options.from_table("place")
@options.from_table("recording")
@options.asking(*options.PLANNED, *options.JUDGED)
def cli(
    job: Job, *, recording: Path | None, min_confidence: float, out: Path, pdf: Path | None
) -> None:
    """Where to mount roadside cameras so that pedestrians and cyclists are not hit.

    Finds the best layout for the junction of the CarlaNCAP study, proves that it is, evaluates it
    by full perception and emergency braking, compares it with the study's 12 cameras, and writes
    a report.
    """
    context, question = click.get_current_context(), job.question
    if context.invoked_subcommand is not None:
        names = [(param, str(param.name)) for param in context.command.params]
        given = [options.option_name(param) for param, name in names if options.is_given(name)]
        if given:
            raise click.UsageError(
                f"{given[0]}: options of {context.invoked_subcommand} go behind its name"
            )
        return
    if question.budget is None and question.budget_cost is None and not question.target:
        raise click.UsageError(
            "--budget: got nothing; expected a whole number of units, at least 1 (or --target, or "
            "--budget-cost)"
        )
    if recording is not None:
        asked = {"folder": recording, "min_confidence": min_confidence, "chooses": True}
        evaluate_recording(job, out=out if options.is_given("out") else None, **asked)
        return
    browser = None
    if pdf is not None:
        if out.resolve() in pdf.resolve().parents:
            raise click.UsageError(f"--pdf: got {pdf}; expected a file outside of --out")
        from ..report.printing import find_browser

        browser = find_browser()
    job = job.begin()
    from ..jobs import READY
    from ..side_process import side_process

    asks_much = not (options.is_given("cases") or question.speeds or question.approaches)
    with side_process(asks_much and job.compute.workers > 1, **READY) as side:  # loads meanwhile
        from ..jobs import placement

        result = placement.run_placement(
            job.question, out=out, command=command_line(), side=side, **job.means
        )
    from .answers import placement_parts

    if browser is not None and pdf is not None:
        from ..report.printing import print_page

        job.progress(mark("print"), 0, 0)
        try:
            print_page(browser, out / "report.html", pdf)
        except OSError as error:
            raise click.UsageError(f"--pdf: got {pdf}: {error.strerror or error}") from None
    job.print_answer(result, lambda: placement_parts(result, out))
