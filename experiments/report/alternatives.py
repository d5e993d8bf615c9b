"""Sentences that put an answer in doubt: heavy runs, other priorities, the evaluator, mounting."""

from ..results.alternatives import (
    ByRunsRecord,
    FrontRunnersRecord,
    HeavyRunRecord,
    StandingRecord,
    SturdierRecord,
)
from ..results.folders import RECOMMENDED_FILE
from ..results.numbers import count_runs, first_of, percent
from ..results.result import Result

_MAX_HEAVY = 8


def recommended_sentences(result: Result) -> list[str]:
    """Which layout the evaluator prefers; nothing where that is the one found."""
    if not result.front_runners or result.front_runners.decided_by == "order":
        return []
    stages = result.stages or ()
    is_proven = any(stage.name == "apr" and stage.gap == 0.0 for stage in stages)
    return [_recommended(result.front_runners, is_proven=is_proven)]


def _recommended(found: FrontRunnersRecord, *, is_proven: bool) -> str:
    first = found.layouts[0]
    best = next(one for one in found.layouts if one.name == found.recommended)
    left = f"{percent(best.apr_one_failed)} against {percent(first.apr_one_failed)}"
    if found.decided_by == "apr":
        why = f"APR {percent(best.apr)} against {percent(first.apr)}"
        if len(first.layout) > 1:
            why += f", and {left} if any one unit fails"
    elif found.decided_by == "apr_one_failed":
        why = f"the same APR, {percent(first.apr)}, and {left} if any one unit fails"
    else:
        assert best.mounting
        assert first.mounting
        why = (
            "the same APR, and a unit mounted 1 degree or 5 cm off leaves "
            f"{percent(best.mounting.apr)} against {percent(first.mounting.apr)}"
        )
    proof = "is proven best on the detection table" if is_proven else "is the best found"
    return (
        f"Recommended: {best.name}, in {RECOMMENDED_FILE}. The evaluator prefers it to "
        f"{first.name}: {why}. All else here is about {first.name}, which {proof}."
    )


def doubt_sentences(result: Result) -> list[str]:
    """What would change the answer, a sentence or two each; nothing where nobody looked."""
    return [
        *_heavy(result.heavy_runs),
        *([_by_runs(result.by_runs, result.runs)] if result.by_runs else []),
        *([_sturdier(result.sturdier)] if result.sturdier else []),
        *([_mounting(result.mounting)] if result.mounting else []),
    ]


def _heavy(runs: tuple[HeavyRunRecord, ...]) -> list[str]:
    if not runs:
        return []
    low, high = percent(runs[-1].share), percent(runs[0].share)
    shares = high if low == high else f"{low} to {high}"
    names = first_of([one.run for one in runs], _MAX_HEAVY)
    if len(runs) == 1:
        return [f"One run alone counts {shares} of the APR: {names}."]
    return [f"{len(runs)} runs count {shares} of the APR each: {names}."]


def _by_runs(found: ByRunsRecord, n_runs: int) -> str:
    if found.runs_avoided == found.runs_avoided_here:
        if found.is_proven:
            return "If every run counted the same, no layout would be better than this one."
        return (
            "If every run counted the same, no better layout was found in the time for it; that "
            "there is none is not proven."
        )
    best = "best" if found.is_proven else "better"
    return (
        f"If every run counted the same (--weights run), another layout would be {best}: it avoids "
        f"{found.runs_avoided} of {count_runs(n_runs)}, this one {found.runs_avoided_here} (on the "
        "detection table)."
    )


def _sturdier(found: SturdierRecord) -> str:
    return (
        f"More robust for {100.0 * max(found.apr_here - found.apr, 0.0):.1f} points of APR: "
        f"--survive 1 gives {percent(found.apr)}, and {percent(found.apr_one_failed)} if any one "
        f"unit fails, where this gives {percent(found.apr_here)} and "
        f"{percent(found.apr_one_failed_here)} (on the detection table)."
    )


def _mounting(found: StandingRecord) -> str:
    aim = f"{found.aim_deg:g} {'degree' if found.aim_deg == 1.0 else 'degrees'}"
    if found.aim_deg and found.height_m:
        text = f"A unit may be {aim} off its aim or 5 cm too high or low, and no run is lost."
    elif found.aim_deg:
        text = (
            f"A unit may be {aim} off its aim and no run is lost; 5 cm too high or low already "
            "loses one."
        )
    elif found.height_m:
        text = (
            "Mount exactly: half a degree off the aim of a unit already loses a run; 5 cm too high "
            "or low loses none."
        )
    else:
        text = (
            "Mount exactly: half a degree off the aim of a unit, or 5 cm too high or low, already "
            "loses a run."
        )
    if not found.lost_runs:
        return text
    size = f"{abs(found.step):g} degree"
    off = {
        ("yaw", True): f"turned {size} to the left",
        ("yaw", False): f"turned {size} to the right",
        ("pitch", True): f"tilted {size} up",
        ("pitch", False): f"tilted {size} down",
        ("height", True): "5 cm too high",
        ("height", False): "5 cm too low",
    }[found.error, found.step > 0.0]
    lost = count_runs(len(found.lost_runs))
    return (
        f"{text} At worst, 1 degree or 5 cm cost {lost}: with {found.unit} {off} the APR is "
        f"{percent(found.apr)}."
    )
