"""``place-rsus``: the best layout, its proof, evaluation and report."""

from pathlib import Path

import click

from geometry.registry import load_entry

from . import options
from .commands import RECORDED
from .running import QuestionCall, command_line

_EXAMPLES = """\b
Examples:
  place-rsus --budget 3                            the best three cameras
  place-rsus --target 0.99 --least cost            the cheapest way to 99 %
  place-rsus --budget 3 --within carlancap-12      three of the study's own
  place-rsus --budget-cost 9000 --site-cost 2000   the best for the money
  place-rsus --budget 2 --fusion single            each must confirm alone
  place-rsus --budget 3 --cars see                 what units add to cars
  place-rsus --budget 3 --json --quiet | jq .apr   for a machine
  place-rsus --budget 3 --cases protocol-4.5.1 --weights case
  place-rsus --budget 3 --cases CPNCO-50,CBNA --speeds 40-60
  place-rsus --budget 3 --weather day,night,fog --detector response
  place-rsus scenarios list                        what can be driven here
  place-rsus evaluate --layout carlancap-12        the study's 12 cameras
  place-rsus --budget 3 --recording ncap_data      the best recorded units
  place-rsus compare results/latest/layout.json carlancap-12
  place-rsus --scene city.osm --junction "A / B" --budget 3
  place-rsus scene import city.osm -o scene        your own junction ..
  place-rsus --scene scene --budget 3              .. and the best three there
  place-rsus pareto --max 8                        what each further unit buys
  place-rsus retrofit --layout carlancap-12        remove, re-aim or add
  place-rsus sheet --layout results/latest/layout.json --out mounting.pdf
  place-rsus verify results/latest                 check a certificate
  place-rsus doctor                                what is installed here
  place-rsus export --layout results/latest/layout.json --format carla

Exit codes: 0 done, 1 `verify`, `scene check` or `doctor` found a fault, 2 the input is
wrong or cannot be met (one line says what), 130 interrupted, 143 terminated."""


@click.group(
    cls=options.SectionedGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=_EXAMPLES,
)
@click.version_option(package_name="place-rsus")
@options.option(
    "--out",
    type=click.Path(path_type=Path),
    default="results/latest",
    help=(
        "Folder for report, layout, tables and figures; earlier results there are"
        " replaced."
    ),
)
@options.recording_options
@options.sign_option
@options.asking("decision", *options.PLANNED, *options.JUDGED)
def cli(
    job: QuestionCall,
    *,
    recording: Path | None,
    min_confidence: float,
    out: Path,
    sign: Path | None,
) -> None:
    """Where to mount cameras so that pedestrians and cyclists are not hit.

    Finds the best layout for the junction of the CarlaNCAP study, proves that it is,
    evaluates it by full perception and emergency braking, compares it with the study's
    12 cameras, and writes a report.
    """
    context = click.get_current_context()
    question = job.question
    if context.invoked_subcommand is not None:
        names = [(param, str(param.name)) for param in context.command.params]
        given = [
            options.option_name(param)
            for param, name in names
            if options.is_given(name)
        ]
        if given:
            raise click.UsageError(
                f"{given[0]}: options of {context.invoked_subcommand} go behind its"
                " name"
            )
        return
    if question.budget is None and question.budget_cost is None and not question.target:
        raise click.UsageError(
            "--budget: got nothing; expected a whole number of units, at least 1 (or"
            " --target, or --budget-cost)"
        )
    if recording is not None:
        asked = {"folder": recording, "min_confidence": min_confidence, "chooses": True}
        asked |= {"sign": sign}
        evaluate_recording = load_entry(RECORDED)
        evaluate_recording(job, out=out if options.is_given("out") else None, **asked)
        return
    asked_question = job.question
    job = job.begin()
    from ..jobs.search import search
    from ..results import folders
    from .first_answer import first_answer

    folders.expect_results(out, job.progress, sign=sign)
    found = search(job.question, compute=job.compute, progress=job.progress)
    job.announce_lines(first_answer(found))
    # Loaded only now, because the first lines do not need it: evaluator and report.
    from ..jobs import placement

    result = placement.run_placement(
        job.question,
        out=out,
        command=command_line(),
        found=found,
        asked=asked_question,
        sign=sign,
        **job.means,
    )
    from .answers import placement_parts

    job.print_answer(result, lambda: placement_parts(result, out))
