"""``place-rsus verify``: check a result without the optimiser."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from . import options
from .running import Call
from .terminal import sentences

if TYPE_CHECKING:
    from ..jobs.verify import VerificationResult

_EXIT_FAILED = 1


_EXAMPLES = """\b
Examples:
  place-rsus verify results/latest
  place-rsus verify results/latest --json --quiet | jq .is_verified

Exit codes: 0 all checks hold, 1 a check has failed, 2 the input is wrong."""


@click.command(epilog=_EXAMPLES)
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@options.scene_option
@options.calling
def verify(call: Call, *, folder: Path, scene: str) -> None:
    """Check a folder of results, without the optimiser.

    Recomputes from certificate.json and instance.npz, by code that it does not share with the
    optimiser: that the instance is the one that was solved, that the layout is within all limits
    and reaches all floors, and its value in every stage. Bounds are proven again where all poses
    together reach no more, or where there are few enough sets of poses to compare them all;
    elsewhere they rest on the solver that the certificate names, and this says so.

    Every file is compared with SHA256SUMS, with the instance, which has the poses and sensors that
    were solved, and with each other; --scene adds the scene. What cannot be compared with anything
    is listed.
    """
    call.start()
    from ..jobs.verify import run_verification

    summary = run_verification(folder, scene=scene, progress=call.progress)
    call.print(summary, lambda: verification_text(summary))
    if not summary.is_verified:
        sys.exit(_EXIT_FAILED)


def verification_text(summary: "VerificationResult") -> str:
    """A line per check, then what was proven again and what was not."""
    checks, stages = summary.checks, summary.stages
    n_failed = sum(not check.passed for check in checks)
    lines = [f"Checked {summary.folder}:"]
    for check in checks:
        head = f"{'OK' if check.passed else 'FAILED':<6} "
        text = f"{check.name}: {check.detail}"
        lines += sentences(text, head=head, indent=2, hanging=len(head))
    again = [stage for stage in stages if stage.is_proven_again is True]
    if again:
        told = (f"{stage.name}: {stage.reason}" for stage in again)
        lines += ["", "Proven again, without a solver:", *sentences(*told, indent=2, hanging=2)]
    open_stages = [stage.name for stage in stages if stage.gap != 0.0]
    if open_stages:
        lines += ["", *sentences(f"Not claimed to be best: {', '.join(open_stages)}.")]
    lines += ["", "Not checked here:", *sentences(*summary.not_checked, indent=2, hanging=2)]
    end = f"{n_failed} FAILED" if n_failed else "all OK"
    return "\n".join([*lines, "", f"{len(checks)} checks: {end}."])
