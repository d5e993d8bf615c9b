"""``place-rsus doctor``: what is installed, what is missing, what that costs."""

import sys

import click

from .call import cache_folder
from .cli_options import json_option

_EXIT_FAILED = 1


@click.command(
    epilog="""\b
Examples:
  place-rsus doctor
  place-rsus doctor --json | jq .extras

Exit codes: 0 all is well (extras may be missing), 1 something is not."""
)
@json_option
def doctor(*, as_json: bool) -> None:
    """Say what is installed here, what is missing, and what that costs."""
    from .doctor import doctor_text, examine
    from .export_formats.json_text import to_json_text

    summary = examine(cache_folder())
    click.echo(to_json_text(summary).rstrip() if as_json else doctor_text(summary))
    if not summary["is_well"]:
        sys.exit(_EXIT_FAILED)
