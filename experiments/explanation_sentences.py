"""Why these poses, what they miss, what else would do: in sentences.

Runs of weight 0 are told nowhere but in one sentence that says how many they are: no ratio knows
them, so that "1 run is not avoided" beside an APR of 100 % would only puzzle.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from .sentences import STAGES, count_runs
from .tables import percent

OUTCOMES: Mapping[str, str] = {
    "hopeless": "too short for any unit",
    "never seen": "never seen",
    "never confirmed": "seen, but never long enough",
    "too late": "confirmed too late",
}
"""What became of a run that is not avoided, in words."""

_CAUSES = {
    "out of view": "out of view",
    "cut off": "cut off by the edge of the view",
    "too dark": "too little contrast in light and weather",
    "too far": "too small or too thin at that distance",
    "otherwise": "not detected on the table",
}


def contribution_sentences(explained: Mapping[str, Any]) -> list[str]:
    """Which units something hangs on, in sentences.

    Parameters
    ----------
    explained : mapping
        By :func:`experiments.explanations.summarise_explanations`.
    """
    parts = explained["contributions"]
    if is_nothing_avoided(parts):
        return [f"{'This unit avoids' if len(parts) == 1 else 'These units avoid'} nothing."]
    if len(parts) == 1:
        return ["Everything that is avoided hangs on this one unit."]
    needed = [part for part in parts if part["only_runs"]]
    if not needed:
        others = "the other avoids" if len(parts) == 2 else "the others avoid"
        return [
            f"No run hangs on a single unit: whichever fails, {others} all that they avoid "
            "together. What each unit adds is time."
        ]
    if len(needed) == len(parts):
        return ["Each unit saves runs that no other one saves."]
    verb = "saves" if len(needed) == 1 else "save"
    return [f"Of {len(parts)} units, {len(needed)} {verb} runs that no other one saves."]


def is_nothing_avoided(parts: Sequence[Mapping[str, Any]]) -> bool:
    """Whether units avoid nothing together."""
    return all(part["without"]["apr"] + part["marginal_apr"] <= 0.0 for part in parts)


def missed_sentences(explained: Mapping[str, Any]) -> list[str]:
    """How many runs are not avoided, and what is most often in the way.

    Parameters
    ----------
    explained : mapping
        By :func:`experiments.explanations.summarise_explanations`.
    """
    return [*missed_counts(explained), *_causes_and_remedies(explained["not_avoided"])]


def missed_counts(explained: Mapping[str, Any], *, with_outcomes: bool = True) -> list[str]:
    """How many runs are not avoided, and how many are left out.

    Parameters
    ----------
    explained : mapping
        By :func:`experiments.explanations.summarise_explanations`.
    with_outcomes : bool
        Say what became of them, too.
    """
    missed, n_without = explained["not_avoided"], explained["runs_without_weight"]
    which = "every run that counts" if n_without else "every run"
    sentences = [f"On the detection table, {which} is avoided."]
    if missed:
        verb = "is" if len(missed) == 1 else "are"
        outcomes = f": {_outcomes(missed)}" if with_outcomes else ""
        sentences = [
            f"On the detection table, {count_runs(len(missed))} {verb} not avoided{outcomes}."
        ]
    if n_without:
        sentences.append(f"Left out: {count_runs(n_without)} of weight 0.")
    return sentences


def _outcomes(missed: Sequence[Mapping[str, Any]]) -> str:
    counts = Counter(entry["outcome"] for entry in missed)
    if len(counts) == 1:
        words = OUTCOMES[missed[0]["outcome"]]
        return words if len(missed) == 1 else f"all {words}"
    return ", ".join(f"{count} {OUTCOMES[outcome]}" for outcome, count in counts.most_common())


def _causes_and_remedies(missed: Sequence[Mapping[str, Any]]) -> list[str]:
    sentences = []
    causes = Counter(cause(entry["reasons"][0]) for entry in missed if entry["reasons"])
    if causes:
        words, n_runs = causes.most_common(1)[0]
        if len(missed) == 1:
            sentences.append(f"The main cause: {words}.")
        elif len(causes) == 1 or n_runs > 1:  # else each run has a cause of its own
            sentences.append(f"The most frequent cause: {words}, in {count_runs(n_runs)}.")
    n_saved = sum(entry["rescue"] is not None for entry in missed)
    if n_saved:
        which = f"{count_runs(n_saved)} could{' each' if n_saved > 1 else ''}"
        if len(missed) == 1:
            which = "It could"
        elif n_saved == len(missed):
            which = "Each of them could"
        sentences.append(f"{which} be saved by a further unit.")
    return sentences


def cause(reason: Mapping[str, Any]) -> str:
    """Why a unit does not detect the road user, in words.

    Parameters
    ----------
    reason : mapping
        ``{"cause", "thing", "frames"}`` of :func:`experiments.explanations.summarise_explanations`.
    """
    if reason["cause"] == "hidden":
        return f"hidden by {reason['thing']}"
    return _CAUSES[reason["cause"]]


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
            f"Found by exchanging units one for one: {count_layouts(within)} with {worth}. There "
            "may be more, and better ones among them in what comes after."
        ]
    sentences = [f"All choices were gone through: {count_layouts(within)} with {worth}."]
    if within > len(pool["sets"]):
        sentences.append(_listed(len(pool["sets"])))
    always = [site["site"] for site in pool["sites"] if site["share"] == 1.0]
    if always and within > 1:
        sentences.append(f"Each of them has a unit at {', '.join(always)}.")
    return sentences


def _listed(count: int) -> str:
    return "The best one is listed." if count == 1 else f"The {count} best of them are listed."


def count_layouts(count: int) -> str:
    """'1 layout', '1,234 layouts' and so on."""
    return "1 layout" if count == 1 else f"{count:,} layouts"
