"""``place-rsus verify``: check a result without the optimiser."""

import sys
from pathlib import Path

import click

from ..progress import StageProgress
from .options import json_option, quiet_option
from .running import print_result

_EXIT_FAILED = 1


@click.command(
    epilog="""\b
Examples:
  place-rsus verify results/latest
  place-rsus verify results/latest --json --quiet | jq .is_verified

Exit codes: 0 all checks hold, 1 a check has failed, 2 the input is wrong."""
)
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@json_option
@quiet_option
@click.pass_obj
def verify(progress: StageProgress, *, folder: Path, as_json: bool, quiet: bool) -> None:
    """Check the certificate in a folder of results, without the optimiser.

    Recomputes from certificate.json and instance.npz, by code that it does not share with the
    optimiser: that the instance is the one that was solved, that the layout is within all limits
    and reaches all floors, and its value in every stage. Bounds are proven again where all poses
    together reach no more, or where there are few enough sets of poses to compare them all;
    elsewhere they rest on the solver that the certificate names, and this says so.
    """
    progress.start(quiet=quiet)
    from ..jobs.verify import run_verification, verification_table

    summary = run_verification(folder, progress=progress)
    print_result(summary, progress, as_json, lambda: verification_table(summary))
    if not summary["is_verified"]:
        sys.exit(_EXIT_FAILED)
