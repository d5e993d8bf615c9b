"""Why these poses, and what they are worth in sampled worlds, in short: for a terminal."""

from collections.abc import Sequence

from placement.explain import Unavoided

from ..parts.explanation import (
    OUTCOMES,
    ContributionRecord,
    ExplainedRecord,
    cause,
    contribution_sentences,
    is_nothing_avoided,
    missed_counts,
    missed_sentences,
    pool_sentences,
)
from ..parts.sampled_worlds import SampledRecord
from ..results.numbers import count_runs, first_of, number, percent, points, shortened
from .terminal import sentences

_MAX_RUNS, _MAX_MISSED, _MAX_SETS, _MAX_SITES = 3, 8, 5, 8
_NAME_WIDTH = 20


def explanation_text(explained: ExplainedRecord) -> str:
    """All of it in short, at most 80 columns wide."""
    parts = explained.contributions
    these = "this unit" if len(parts) == 1 else "these units"
    lines = [f"Why {these}, on the detection table:"]
    if is_nothing_avoided(parts):
        lines += _indented(" ".join(contribution_sentences(explained)))
    else:
        for part in parts:
            lines += _indented(_in_short(part, n_units=len(parts)))
    groups = _alike(explained.not_avoided)
    said = missed_sentences(explained)
    if len(groups) == 1:  # the line about them says it all: once is enough
        said = missed_counts(explained, with_outcomes=False)
    lines += sentences(" ".join(said))
    for group in groups[:_MAX_MISSED]:
        lines += _indented(_missed_in_short(group))
    lines += _and_more(sum(map(len, groups[_MAX_MISSED:])))
    if explained.pool is not None:
        lines += ["", *sentences(" ".join(pool_sentences(explained)))]
        sets = explained.pool.sets
        for entry in sets[:_MAX_SETS]:
            lines += _indented(
                f"{' + '.join(entry.units)}: APR {percent(entry.apr)}, if one fails "
                f"{percent(entry.apr_one_failed)}, {entry.smallest_margin_s:.2f} s to spare"
            )
        lines += _and_more(len(sets) - _MAX_SETS)
        sites = ", ".join(
            f"{site} {percent(share)}"
            for site, share in list(explained.pool.sites.items())[:_MAX_SITES]
        )
        lines += _indented(f"sites: {sites}")
    return "\n".join(lines)


def _alike(missed: Sequence[Unavoided]) -> list[list[Unavoided]]:
    """Runs that have the same said of them, but for numbers; the largest group first."""
    groups: dict[tuple[str, ...], list[Unavoided]] = {}
    for entry in missed:
        because = cause(entry.reasons[0]) if entry.reasons else ""
        rescue = entry.rescue.unit if entry.rescue else ""
        groups.setdefault((entry.outcome, entry.unit, because, rescue), []).append(entry)
    return sorted(groups.values(), key=len, reverse=True)


def _missed_in_short(group: Sequence[Unavoided]) -> str:
    first = group[0]
    runs = first_of([entry.run for entry in group], _MAX_RUNS)
    words = f"{runs}: {OUTCOMES[first.outcome]}"
    if first.reasons:
        words += f"; for {first.unit} {cause(first.reasons[0])}"
    rescue = first.rescue
    return words if rescue is None else f"{words}; would be saved by {rescue.unit}"


def _in_short(part: ContributionRecord, *, n_units: int) -> str:
    unit, runs = part.unit, part.only_runs
    saved = f"{count_runs(len(runs))} ({first_of(runs, _MAX_RUNS)})"
    if n_units == 1:
        return f"{unit}: saves {saved}, an APR of {percent(part.marginal_apr)}"
    words = f"{unit}: no run depends on it alone"
    if runs:
        words = f"{unit}: only it saves {saved}, {points(part.marginal_apr)} of the APR"
    if part.without.apr == 0.0:
        return words
    what = "the other saves" if n_units == 2 else "the others save"
    delay = number(part.mean_delay_s)
    when = "as early" if delay == number(0.0) else f"{delay} s later on average"
    return f"{words}; without it what {what} is confirmed {when}"


def _indented(text: str) -> list[str]:
    return sentences(text, indent=2, hanging=2)


def _and_more(count: int) -> list[str]:
    return [f"  and {count} more in summary.json"] if count > 0 else []


def uncertainty_text(found: SampledRecord) -> str:
    """A small table for a terminal, at most 80 columns wide."""
    has_tail = found.tail < 1.0  # the mean of all is there already
    tail = f"worst {100.0 * found.tail:g} %"
    head = f"  {'layout':<{_NAME_WIDTH}} {'planned':>8} {'mean':>8} {'95 % interval':>18}"
    lines = [
        f"APR in {found.samples} fresh sampled {'world' if found.samples == 1 else 'worlds'}, "
        f"uncertainty {found.uncertainty.name}",
        head + (f" {tail:>10}" if has_tail else "") + f" {'worst':>8}",
    ]
    for layout in found.layouts:
        name = shortened(layout.name, _NAME_WIDTH)
        interval = f"{percent(layout.low)} .. {percent(layout.high)}"
        lines.append(
            f"  {name:<{_NAME_WIDTH}} {percent(layout.planned):>8} {percent(layout.mean):>8} "
            + f"{interval:>18}"
            + (f" {percent(layout.cvar):>10}" if has_tail else "")
            + f" {percent(layout.worst):>8}"
        )
    if found.moving:
        from ..parts.sampled_worlds import moving_sentence

        lines += sentences(f"{moving_sentence(found)}.", indent=2)
    return "\n".join(lines)
