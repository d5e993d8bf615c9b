"""A verification as plain text for a terminal, at most 80 columns wide."""

import textwrap
from typing import Any

_WIDTH = 80


def verification_table(summary: dict[str, Any]) -> str:
    """A line per check, then what was proven again and what was not.

    Parameters
    ----------
    summary : dict
        Of :func:`experiments.verify_jobs.run_verification`.
    """
    checks = summary["checks"]
    n_failed = sum(not check["passed"] for check in checks)
    lines = [f"Checked {summary['folder']}:"]
    for check in checks:
        verdict = "OK" if check["passed"] else "FAILED"
        lines += _wrapped(f"{verdict:<6} {check['name']}: {check['detail']}", indent=9)
    again = [stage for stage in summary["stages"] if stage.get("is_proven_again")]
    if again:
        lines += ["", "Proven again, without a solver:"]
        for stage in again:
            lines += _wrapped(f"{stage['name']}: {stage['reason']}", indent=4)
    open_stages = [stage["name"] for stage in summary["stages"] if stage["gap"] != 0.0]
    if open_stages:
        lines += ["", *textwrap.wrap(f"Not claimed to be best: {', '.join(open_stages)}.", _WIDTH)]
    lines += ["", "Not checked here:"]
    for words in summary["not_checked"]:
        lines += _wrapped(words, indent=4)
    end = f"{n_failed} FAILED" if n_failed else "all OK"
    lines += ["", f"{len(checks)} checks: {end}."]
    return "\n".join(lines)


def _wrapped(text: str, *, indent: int) -> list[str]:
    return textwrap.wrap(
        text,
        _WIDTH,
        initial_indent="  ",
        subsequent_indent=" " * indent,
        break_on_hyphens=False,
    )
