"""``--recording``: the options of commands that work on recorded detections as well."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from .options import Share, option_name

_WITH_RECORDING = frozenset(
    ("recording", "min_confidence", "out", "as_json", "quiet", "budget", "fusion")
    + ("solver", "milp_solver", "time_limit_s", "gap")
    + ("deceleration_mps2", "build_up_s", "latency_s", "n_confirmations")
    + ("latency_budget", "latency_mode")
)


def recording_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--recording`` and ``--min-confidence`` to a command."""
    confidence = click.option(
        "--min-confidence",
        type=Share("a confidence"),
        default=0.0,
        show_default=True,
        help="With --recording: detections below do not count.",
    )
    return click.option(
        "--recording",
        type=click.Path(path_type=Path),
        metavar="DIR",
        help="Work on recorded detections in the study's folder format; --out gets summary.json.",
    )(confidence(command))


def is_given(name: str) -> bool:
    """Whether an option of the running command stands on the command line."""
    source = click.get_current_context().get_parameter_source(name)
    return source is click.core.ParameterSource.COMMANDLINE


def check_recording_options(recording: Path | None) -> None:
    """Refuse options that say nothing beside a recording, or without one.

    Raises
    ------
    click.UsageError
        Which one.
    """
    if recording is None:
        if is_given("min_confidence"):
            raise click.UsageError("--min-confidence: got it without --recording; expected both")
        return
    for param in click.get_current_context().command.params:
        if param.name not in _WITH_RECORDING and is_given(str(param.name)):
            raise click.UsageError(
                f"{option_name(param)}: got it beside --recording; expected one of them: "
                "a recording has units and drives of its own"
            )
