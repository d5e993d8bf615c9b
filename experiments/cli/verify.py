"""``place-rsus verify``: check a result, or make it anew."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from . import options
from .running import Call, begin
from .terminal import sentences

if TYPE_CHECKING:
    from placement.question import Question

    from ..jobs.verify import VerificationResult

_EXIT_FAILED = 1


_EXAMPLES = """\b
Examples:
  place-rsus verify results/latest
  place-rsus verify results/latest --json --quiet | jq .is_verified
  place-rsus verify results/latest --scene city.osm --deep
  place-rsus verify results/latest --key id_ed25519.pub

Exit codes: 0 all checks hold, 1 a check has failed, 2 the input is wrong."""


@click.command(epilog=_EXAMPLES)
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@options.option(
    "--deep",
    is_flag=True,
    help=(
        "Make the result anew from what was asked, as long as that takes, and compare"
        " every file."
    ),
)
@options.option(
    "--key",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Public key, such as id_ed25519.pub: check that it has signed the folder.",
)
@options.question_options(*options.OF_SCENE, has_file=False)
@options.calling
def verify(
    call: Call, *, folder: Path, question: "Question", deep: bool, key: Path | None
) -> None:
    """Check a folder of results, without the optimiser.

    Recomputes from certificate.json and instance.npz, by code that it does not share
    with the optimiser: that the instance is the one that was solved, that the layout is
    within all limits and reaches all floors, and its value in every stage. Bounds are
    proven again where all poses together reach no more, or where there are few enough
    sets of poses to compare them all; elsewhere they rest on the solver that the
    certificate names, and this says so.

    Every file is compared with SHA256SUMS, with the instance, which has the poses and
    sensors that were solved, and with each other; --scene adds the scene: what was said
    of its map when the result was made (--junction, --sites and so on) need not be said
    again. What cannot be compared with anything is listed.

    --deep makes the result anew and compares every file with it: the detection table,
    the search, the evaluator's verdicts, the bill, the report. --key checks who has
    signed the folder.
    """
    from ..jobs.verify import asked_question, run_verification

    has_scene = bool(question.scene)
    if folder.is_dir():
        asked = asked_question(folder)
    else:
        asked = None
    if asked is None and deep:
        raise click.UsageError(
            f"--deep: got {folder}, which does not say what was asked; expected a"
            " placement of this version of place-rsus"
        )
    of_result = _with_scene(asked, question)
    if has_scene or deep:
        of_result = begin(call.progress, of_result, quiet=call.quiet)
    else:
        call.start()
    summary = run_verification(
        folder,
        scene=of_result.scene if has_scene or deep else "",
        question=of_result if deep else None,
        key=key,
        progress=call.progress,
    )
    call.print(summary, lambda: verification_text(summary))
    if not summary.is_verified:
        sys.exit(_EXIT_FAILED)


def _with_scene(asked: "Question | None", given: "Question") -> "Question":
    """What was asked, with scene and map options of the command line."""
    if asked is None:
        return given
    names = [name for name in options.OF_SCENE if options.is_given(name)]
    question = replace(asked, **{name: getattr(given, name) for name in names})
    if "scene" not in names or Path(given.scene).is_file():
        return question
    from geometry.scene_sources import has_scene

    # The junction was cut out of a map before: a scene's folder has no such options.
    if has_scene(Path(given.scene)) or not Path(given.scene).exists():
        cut = [
            name for name in options.OF_SCENE if name != "scene" and name not in names
        ]
        question = replace(question, **{name: getattr(given, name) for name in cut})
    return question


def verification_text(summary: "VerificationResult") -> str:
    """A line per check, then what was proven again and what was not."""
    checks = summary.checks
    stages = summary.stages
    n_failed = sum(not check.passed for check in checks)
    lines = [f"Checked {summary.folder}:"]
    for check in checks:
        head = f"{'OK' if check.passed else 'FAILED':<6} "
        text = f"{check.name}: {check.detail}"
        lines += sentences(text, head=head, indent=2, hanging=len(head))
    again = [stage for stage in stages if stage.is_proven_again is True]
    if again:
        told = (f"{stage.name}: {stage.reason}" for stage in again)
        lines += [
            "",
            "Proven again, without a solver:",
            *sentences(*told, indent=2, hanging=2),
        ]
    open_stages = [stage.name for stage in stages if stage.gap != 0.0]
    if open_stages:
        lines += ["", *sentences(f"Not claimed to be best: {', '.join(open_stages)}.")]
    lines += [
        "",
        "Not checked here:",
        *sentences(*summary.not_checked, indent=2, hanging=2),
    ]
    if n_failed:
        end = f"{n_failed} FAILED"
    else:
        end = "all OK"
    return "\n".join([*lines, "", f"{len(checks)} checks: {end}. {_left_out(summary)}"])


def _left_out(summary: "VerificationResult") -> str:
    """What was not checked, for the last line."""
    left = []
    # There is no placement to make anew.
    if not summary.stages:
        left.append("what is listed above")
    elif not summary.is_deep:
        left.append("verdicts, bill, report (--deep)")
    if not summary.is_signed:
        left.append("who made it (--key)")
    if not left:
        left.append("the times")
    return f"Not checked: {', '.join(left)}."
