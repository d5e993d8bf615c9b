"""Why these poses, what they miss, what else would do: in sentences and tables."""

import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from .sentences import NOTHING, STAGES, count_runs, number
from .tables import percent

_WIDTH = 80
_MAX_RUNS, _MAX_MISSED, _MAX_SETS, _MAX_SITES = 3, 8, 5, 8
_MAX_REASONS = 2

_CAUSES = {
    "out of view": "out of view",
    "cut off": "cut off by the edge of the view",
    "too dark": "too little contrast in light and weather",
    "too far": "too small or too thin at that distance",
    "otherwise": "not detected on the table",
}


# ---------------------------------------------------------------- why these


def contribution_sentences(explained: Mapping[str, Any]) -> list[str]:
    """Which units something hangs on, in sentences.

    Parameters
    ----------
    explained : mapping
        By :func:`experiments.explanations.summarise_explanations`.
    """
    parts = explained["contributions"]
    if len(parts) == 1:
        return ["Everything that is avoided hangs on this one unit."]
    needed = [part for part in parts if part["only_runs"]]
    if not needed:
        return [
            "No run hangs on a single unit: whichever fails, the others avoid all that they avoid "
            "together. What each unit adds is time."
        ]
    if len(needed) == len(parts):
        return ["Each unit saves runs that no other one saves."]
    verb = "saves" if len(needed) == 1 else "save"
    return [f"Of {len(parts)} units, {len(needed)} {verb} runs that no other one saves."]


def contribution_table(
    explained: Mapping[str, Any], labels: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """What each unit is there for: a row each.

    Parameters
    ----------
    explained : mapping
        By :func:`experiments.explanations.summarise_explanations`.
    labels : mapping of str to str, optional
        Short names of the units, by id.

    Returns
    -------
    table : dict
        Caption, columns and rows.
    """
    return {
        "caption": "What each unit is there for, on the detection table",
        "columns": [
            "unit",
            "runs that only it saves",
            "APR it adds",
            "APR without it",
            "smallest time to spare without it (s)",
            "mean time to spare without it (s)",
            "later without it, mean (s)",
            "later, at most (s)",
            "its part in first confirmations",
        ],
        "rows": [
            [
                (labels or {}).get(part["unit"], part["unit"]),
                str(len(part["only_runs"])),
                percent(part["marginal_apr"]),
                percent(part["without"]["apr"]),
                _of_others(part, part["without"]["smallest_margin_s"]),
                _of_others(part, part["without"]["mean_margin_s"]),
                _of_others(part, part["mean_delay_s"]),
                _of_others(part, part["max_delay_s"]),
                percent(part["first_share"]),
            ]
            for part in explained["contributions"]
        ],
    }


def _of_others(part: Mapping[str, Any], value_s: float) -> str:
    """A time of what the others avoid; there is none where they avoid nothing."""
    return number(value_s) if part["without"]["apr"] > 0.0 else NOTHING


# ---------------------------------------------------------------- what they miss


def missed_sentences(explained: Mapping[str, Any]) -> list[str]:
    """How many runs are not avoided, and what is most often in the way.

    Parameters
    ----------
    explained : mapping
        By :func:`experiments.explanations.summarise_explanations`.
    """
    missed = explained["not_avoided"]
    if not missed:
        return ["On the detection table, every run is avoided."]
    outcomes = Counter(entry["outcome"] for entry in missed)
    each = ", ".join(f"{count} {_OUTCOMES[outcome]}" for outcome, count in outcomes.most_common())
    verb = "is" if len(missed) == 1 else "are"
    sentences = [f"On the detection table, {count_runs(len(missed))} {verb} not avoided: {each}."]
    causes = Counter(_cause(entry["reasons"][0]) for entry in missed if entry["reasons"])
    if causes:
        cause, n_runs = causes.most_common(1)[0]
        sentences.append(f"What is in the way most often: {cause}, in {count_runs(n_runs)}.")
    saved = Counter(entry["rescue"]["unit"] for entry in missed if entry["rescue"])
    if saved:
        unit, n_runs = saved.most_common(1)[0]
        sentences.append(
            f"A further unit could save {sum(saved.values())} of them; {unit} is the nearest one "
            f"that does for {count_runs(n_runs)}."
        )
    return sentences


_OUTCOMES = {
    "hopeless": "too short for any unit",
    "never seen": "never seen",
    "never confirmed": "seen, but never long enough",
    "too late": "confirmed too late",
}


def missed_table(explained: Mapping[str, Any]) -> dict[str, Any]:
    """Runs that are not avoided, why, and what would save them: a row each.

    Parameters
    ----------
    explained : mapping
        By :func:`experiments.explanations.summarise_explanations`.

    Returns
    -------
    table : dict
        Caption, columns and rows.
    """
    return {
        "caption": "Runs that are not avoided, on the detection table",
        "columns": ["run", "outcome", "why", "nearest further unit that would save it"],
        "rows": [
            [entry["run"], _outcome(entry), _why(entry), _rescue(entry)]
            for entry in explained["not_avoided"]
        ],
    }


def _outcome(entry: Mapping[str, Any]) -> str:
    words: str = _OUTCOMES[entry["outcome"]]
    if entry["outcome"] != "too late":
        return words
    return f"{words}, by {number(entry['late_s'])} s"


def _why(entry: Mapping[str, Any]) -> str:
    if entry["outcome"] == "hopeless":
        return "the road user is there too late for any confirmation in time"
    reasons = "; ".join(
        f"{_cause(reason)} in {reason['frames']} of {entry['frames_in_time']} frames"
        for reason in entry["reasons"][:_MAX_REASONS]
    )
    return f"for {entry['unit']}: {reasons}" if reasons else "seen, but with gaps"


def _cause(reason: Mapping[str, Any]) -> str:
    if reason["cause"] == "hidden":
        return f"hidden by {reason['thing']}"
    return _CAUSES[reason["cause"]]


def _rescue(entry: Mapping[str, Any]) -> str:
    rescue = entry["rescue"]
    if rescue is None:
        return NOTHING
    away = rescue["distance_m"]
    where = "at the same mount" if away == 0.0 else f"{number(away, 1)} m away"
    return f"{rescue['unit']}, {where}, {number(rescue['margin_s'])} s to spare"


# ---------------------------------------------------------------- what else would do


def pool_sentences(explained: Mapping[str, Any]) -> list[str]:
    """How much there is to choose from; nothing where nobody has looked.

    Parameters
    ----------
    explained : mapping
        By :func:`experiments.explanations.summarise_explanations`.
    """
    pool = explained["pool"]
    if pool is None:
        return []
    stage, within = STAGES.get(pool["stage"], pool["stage"]), pool["within"]
    worth = f"the best {stage}"
    if pool["tolerance"]:
        worth += f", or up to {percent(pool['tolerance'])} of the runs less"
        if pool["stage"] in ("units", "cost_eur"):
            worth = f"the least {stage}, or up to {percent(pool['tolerance'])} more"
    elif pool["stage"] in ("units", "cost_eur"):
        worth = f"the least {stage}"
    if not pool["is_complete"]:
        return [
            f"Found by exchanging units one for one: {_layouts(within)} with {worth}. There may be "
            "more, and better ones among them in what comes after."
        ]
    sentences = [f"All choices were gone through: {_layouts(within)} with {worth}."]
    if within > len(pool["sets"]):
        sentences.append(_listed(len(pool["sets"])))
    always = [site["site"] for site in pool["sites"] if site["share"] == 1.0]
    if always and within > 1:
        sentences.append(f"Each of them has a unit at {', '.join(always)}.")
    return sentences


def _listed(count: int) -> str:
    return "The best one is listed." if count == 1 else f"The {count} best of them are listed."


def pool_table(explained: Mapping[str, Any]) -> dict[str, Any]:
    """Layouts that are as good, or nearly: a row each, the best first.

    Parameters
    ----------
    explained : mapping
        By :func:`experiments.explanations.summarise_explanations`; its pool is there.

    Returns
    -------
    table : dict
        Caption, columns and rows.
    """
    return {
        "caption": "Layouts as good, the best first",
        "columns": [
            "layout",
            "APR",
            "if the most needed unit fails",
            "smallest time to spare (s)",
            "mean time to spare (s)",
            "cost (EUR)",
        ],
        "rows": [
            [
                " + ".join(entry["units"]),
                percent(entry["apr"]),
                percent(entry["apr_one_failed"]),
                number(entry["smallest_margin_s"]),
                number(entry["mean_margin_s"]),
                f"{entry['cost_eur']:,.0f}",
            ]
            for entry in explained["pool"]["sets"]
        ],
    }


def site_table(explained: Mapping[str, Any]) -> dict[str, Any]:
    """How often each site appears in the layouts that are as good: a row each."""
    pool = explained["pool"]
    whole = "all" if pool["is_complete"] else "the listed"
    return {
        "caption": f"How often each site carries a unit, of {whole} {_layouts(pool['within'])}",
        "columns": ["site", "share of the layouts"],
        "rows": [[site["site"], percent(site["share"])] for site in pool["sites"]],
    }


def _layouts(count: int) -> str:
    return "1 layout" if count == 1 else f"{count:,} layouts"


# ---------------------------------------------------------------- for a terminal


def explanation_text(explained: Mapping[str, Any]) -> str:
    """All of it in short, at most 80 columns wide.

    Parameters
    ----------
    explained : mapping
        By :func:`experiments.explanations.summarise_explanations`.
    """
    lines = ["Why these units, on the detection table:"]
    for part in explained["contributions"]:
        lines += _wrapped(_in_short(part))
    lines += _wrapped(" ".join(missed_sentences(explained)), indent="")
    groups = _alike(explained["not_avoided"])
    for group in groups[:_MAX_MISSED]:
        lines += _wrapped(_missed_in_short(group))
    lines += _and_more(sum(map(len, groups[_MAX_MISSED:])))
    if explained["pool"] is not None:
        lines += ["", *_wrapped(" ".join(pool_sentences(explained)), indent="")]
        sets = explained["pool"]["sets"]
        for entry in sets[:_MAX_SETS]:
            lines += _wrapped(
                f"{' + '.join(entry['units'])}: APR {percent(entry['apr'])}, if one fails "
                f"{percent(entry['apr_one_failed'])}, {entry['smallest_margin_s']:.2f} s to spare"
            )
        lines += _and_more(len(sets) - _MAX_SETS)
        sites = ", ".join(
            f"{site['site']} {percent(site['share'])}"
            for site in explained["pool"]["sites"][:_MAX_SITES]
        )
        lines += _wrapped(f"sites: {sites}")
    return "\n".join(lines)


def _alike(missed: Sequence[Mapping[str, Any]]) -> list[list[Mapping[str, Any]]]:
    """Runs that have the same said of them, but for numbers; the largest group first."""
    groups: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for entry in missed:
        cause = _cause(entry["reasons"][0]) if entry["reasons"] else ""
        rescue = entry["rescue"]["unit"] if entry["rescue"] else ""
        groups.setdefault((entry["outcome"], entry["unit"], cause, rescue), []).append(entry)
    return sorted(groups.values(), key=len, reverse=True)


def _missed_in_short(group: Sequence[Mapping[str, Any]]) -> str:
    first = group[0]
    runs = _first_runs([entry["run"] for entry in group])
    words = f"{runs}: {_OUTCOMES[first['outcome']]}"
    if first["reasons"]:
        words += f"; for {first['unit']} {_cause(first['reasons'][0])}"
    rescue = first["rescue"]
    return words if rescue is None else f"{words}; would be saved by {rescue['unit']}"


def _first_runs(runs: Sequence[str]) -> str:
    listed = ", ".join(runs[:_MAX_RUNS])
    left = len(runs) - _MAX_RUNS
    return f"{listed} and {left} more" if left > 0 else listed


def _in_short(part: Mapping[str, Any]) -> str:
    runs = part["only_runs"]
    words = f"{part['unit']}: no run hangs on it alone"
    if runs:
        words = (
            f"{part['unit']}: only it saves {count_runs(len(runs))} ({_first_runs(runs)}), "
            f"{percent(part['marginal_apr'])} of the APR"
        )
    if part["without"]["apr"] == 0.0:
        return words
    return (
        f"{words}; without it what the others save is confirmed {number(part['mean_delay_s'])} s "
        "later on average"
    )


def _wrapped(text: str, indent: str = "  ") -> list[str]:
    return textwrap.wrap(
        text,
        _WIDTH,
        initial_indent=indent,
        subsequent_indent=indent + "  " if indent else "",
        break_on_hyphens=False,
    )


def _and_more(count: int) -> list[str]:
    return [f"  and {count} more in summary.json"] if count > 0 else []


def report_part(
    explained: Mapping[str, Any] | None, labels: Mapping[str, str]
) -> dict[str, Any] | None:
    """What ``templates/explanations.html.j2`` shows.

    Parameters
    ----------
    explained : mapping or None
        By :func:`experiments.explanations.summarise_explanations`; None: nothing is explained.
    labels : mapping of str to str
        Short names of the layout's units, by id.
    """
    if explained is None:
        return None
    has_pool = explained["pool"] is not None
    return {
        "why": contribution_sentences(explained),
        "contributions": contribution_table(explained, labels),
        "missed_text": missed_sentences(explained),
        "missed": missed_table(explained),
        "pool_text": pool_sentences(explained),
        "pool": pool_table(explained) if has_pool else None,
        "sites": site_table(explained) if has_pool else None,
    }
