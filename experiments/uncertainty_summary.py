"""What layouts are worth in sampled worlds: as one plain object, in sentences, as text, drawn."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import combinations
from typing import Any

import numpy as np

from geometry.errors import InputError, Unquoted
from placement.sampling import SampledApr, Uncertainty, cvar, estimate_mean
from placement.sampling.uncertainty import StandingTraffic

from .tables import percent

_MAX_FRAGILE = 5
_NAME_WIDTH = 20
_SAME_APR = 1.0e-9  # shares of summed weights carry rounding noise


def summarise_uncertainty(
    judged: Sequence[SampledApr],
    uncertainty: Uncertainty,
    *,
    tail: float,
    seed: int,
    planned_apr: Mapping[str, float] | None = None,
    chosen_apr: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Layouts in the same fresh worlds: the first one is the subject, the others baselines.

    Parameters
    ----------
    judged : sequence of SampledApr
        By :func:`placement.sampling.out_of_sample_layouts`: at least one, all in the same worlds.
    uncertainty : Uncertainty
        What was drawn.
    tail : float
        The worst share of the worlds that is summed up, 0 .. 1.
    seed : int
        Of the draws.
    planned_apr, chosen_apr : mapping of str to float, optional
        By name of the layout: APR as planned, with nothing uncertain, and in the worlds that it
        was chosen in.

    Returns
    -------
    summary : dict
        Ready for JSON; ratios are 0 .. 1. ``{"uncertainty": {..}, "samples", "seed", "tail",
        "layouts": [{"name", "planned", "in_sample", "mean", "standard_error", "low", "high",
        "method", "cvar", "worst", "apr_by_sample": [..], "least_sure_runs": [{"run",
        "avoided_share"}]}], "gains": [{"over", "mean", "standard_error", "low", "high",
        "method"}], "pairs": [{"first", "second", "mean", "standard_error", "low", "high", "method",
        "more_share", "equal_share", "less_share"}]}``; a gain is the subject's APR less the
        other's, world by world; a pair is any two layouts, the first one's APR less the second
        one's, and in what share of the worlds it avoids more, as much and less.

    Raises
    ------
    InputError
        There is no layout, or they were judged in different numbers of worlds.
    """
    if not judged:
        raise InputError("layouts", Unquoted("none"), "at least one")
    n_samples = {len(item.apr_by_sample) for item in judged}
    if len(n_samples) > 1:
        raise InputError("samples", sorted(n_samples), "the same number for every layout")
    subject, *others = judged
    planned, chosen = planned_apr or {}, chosen_apr or {}
    return {
        "uncertainty": uncertainty_record(uncertainty),
        "samples": n_samples.pop(),
        "seed": seed,
        "tail": tail,
        "layouts": [
            {
                "name": item.layout.name,
                "planned": planned.get(item.layout.name),
                "in_sample": chosen.get(item.layout.name),
                **asdict(item.estimate),
                "cvar": cvar(item.apr_by_sample, tail),
                "worst": item.worst,
                "apr_by_sample": item.apr_by_sample.tolist(),
                "least_sure_runs": _least_sure(item),
            }
            for item in judged
        ],
        "gains": [
            {
                "over": other.layout.name,
                **asdict(
                    estimate_mean(subject.apr_by_sample - other.apr_by_sample, bounds=(-1.0, 1.0))
                ),
            }
            for other in others
        ],
        "pairs": [_pair(first, second) for first, second in combinations(judged, 2)],
    }


def _pair(first: SampledApr, second: SampledApr) -> dict[str, Any]:
    """Two layouts in the same worlds: the difference, and who avoids more how often."""
    gain = first.apr_by_sample - second.apr_by_sample
    more, less = float((gain > _SAME_APR).mean()), float((gain < -_SAME_APR).mean())
    return {
        "first": first.layout.name,
        "second": second.layout.name,
        **asdict(estimate_mean(gain, bounds=(-1.0, 1.0))),
        "more_share": more,
        "equal_share": float((np.abs(gain) <= _SAME_APR).mean()),
        "less_share": less,
    }


def uncertainty_record(uncertainty: Uncertainty) -> dict[str, Any]:
    """An uncertainty as a plain object, with the names of its TOML file."""
    latency, traffic = uncertainty.latency, uncertainty.traffic
    budget = latency.budget
    return {
        "name": uncertainty.name,
        "mounting": asdict(uncertainty.mounting),
        "latency": {
            **(
                {"budget": budget.name}
                if budget is not None
                else {
                    "distribution": latency.distribution,
                    "mean_s": latency.mean_s,
                    "sd_s": latency.sd_s,
                }
            ),
            "drawn_per": latency.drawn_per,
        },
        "messages": {"packet_loss": uncertainty.packet_loss},
        "detector": {"is_drawn": uncertainty.draws_detections},
        "traffic": {
            name: getattr(traffic, name)
            for name in StandingTraffic.__annotations__
            if name != "vehicles"
        },
        "vehicles": [
            {
                "name": kind.actor.name,
                "parked_share": kind.parked_share,
                "waiting_share": kind.waiting_share,
            }
            for kind in traffic.vehicles
        ],
    }


def uncertainty_sentences(summary: Mapping[str, Any]) -> list[str]:
    """What the sampled worlds say, in sentences.

    Parameters
    ----------
    summary : mapping
        By :func:`summarise_uncertainty`.
    """
    subject = summary["layouts"][0]
    n_samples = summary["samples"]
    planned = subject["planned"]
    sentences = [
        f"In {n_samples} fresh sampled {_worlds(n_samples)} ({what_is_uncertain(summary)}), "
        f"{subject['name']} avoids {percent(subject['mean'])} of the accidents on average "
        f"({_interval(subject)})" + ("" if planned is None else f"; as planned {percent(planned)}")
    ]
    chosen = subject["in_sample"]
    if chosen is not None:
        sentences.append(
            f"In the worlds that it was chosen in, it avoids {percent(chosen)}: "
            "a choice looks better where it was made"
            if chosen > subject["mean"]
            else f"In the worlds that it was chosen in, it avoids {percent(chosen)}"
        )
    if summary["tail"] < 1.0:
        sentences.append(
            f"In the worst {percent(summary['tail'])} of these worlds it avoids "
            f"{percent(subject['cvar'])} on average, in the very worst {percent(subject['worst'])}"
        )
    else:
        sentences.append(f"In the worst of these worlds it avoids {percent(subject['worst'])}")
    for gain in summary["gains"]:
        sentences.append(_gain(subject["name"], gain))
    unsure = subject["least_sure_runs"]
    if unsure:
        listed = ", ".join(f"{run['run']} ({percent(run['avoided_share'])})" for run in unsure)
        sentences.append(f"Least sure, with the share of worlds that avoid them: {listed}")
    return [f"{sentence}." for sentence in sentences]


def uncertainty_text(summary: Mapping[str, Any]) -> str:
    """A small table for a terminal, at most 80 columns wide."""
    has_tail = summary["tail"] < 1.0  # the mean of all is there already
    tail = f"worst {100.0 * summary['tail']:g} %"
    head = f"  {'layout':<{_NAME_WIDTH}} {'planned':>8} {'mean':>8} {'95 % interval':>18}"
    lines = [
        f"APR in {summary['samples']} fresh sampled {_worlds(summary['samples'])}, "
        f"uncertainty {summary['uncertainty']['name']}",
        head + (f" {tail:>10}" if has_tail else "") + f" {'worst':>8}",
    ]
    for layout in summary["layouts"]:
        name = layout["name"]
        if len(name) > _NAME_WIDTH:
            name = name[: _NAME_WIDTH - 1] + "\N{HORIZONTAL ELLIPSIS}"
        planned = math.nan if layout["planned"] is None else layout["planned"]
        interval = f"{percent(layout['low'])} .. {percent(layout['high'])}"
        lines.append(
            f"  {name:<{_NAME_WIDTH}} {percent(planned):>8} {percent(layout['mean']):>8} "
            + f"{interval:>18}"
            + (f" {percent(layout['cvar']):>10}" if has_tail else "")
            + f" {percent(layout['worst']):>8}"
        )
    return "\n".join(lines)


def what_is_uncertain(summary: Mapping[str, Any]) -> str:
    """What is drawn in the sampled worlds, in words."""
    record = summary["uncertainty"]
    mounting, latency, traffic = record["mounting"], record["latency"], record["traffic"]
    parts = []
    if any(mounting.values()):
        parts.append(
            f"units off by {mounting['yaw_sd_deg']:g}\N{DEGREE SIGN} in yaw, "
            f"{mounting['pitch_sd_deg']:g}\N{DEGREE SIGN} in pitch and "
            f"{100.0 * mounting['height_sd_m']:g} cm in height"
        )
    if "budget" in latency:
        parts.append(f"latency drawn from the budget {latency['budget']}")
    elif latency["mean_s"] > 0.0:
        parts.append(f"messages {1000.0 * latency['mean_s']:g} ms later on average")
    if record["messages"]["packet_loss"] > 0.0:
        parts.append(f"{percent(record['messages']['packet_loss'])} of the messages lost")
    if record["detector"]["is_drawn"]:
        parts.append("detections drawn where the detector gives a probability")
    if traffic["taken_share"] > 0.0:
        parts.append(f"{percent(traffic['taken_share'])} of the parking places taken")
    if traffic["waiting_share"] > 0.0:
        parts.append(f"vehicles waiting in {percent(traffic['waiting_share'])} of the lanes")
    return ", ".join(parts) or "nothing is uncertain"


def _least_sure(item: SampledApr) -> list[dict[str, Any]]:
    """Runs that are avoided in the fewest worlds, if not in all; those that count."""
    share = item.avoided_share
    order = np.argsort(share, kind="stable")
    order = order[(share[order] < 1.0) & (item.axis.weight[order] > 0.0)]
    return [
        {"run": item.axis.run_ids[index], "avoided_share": float(share[index])}
        for index in order[:_MAX_FRAGILE].tolist()
    ]


def _gain(name: str, gain: Mapping[str, Any]) -> str:
    points, low, high = (100.0 * gain[key] for key in ("mean", "low", "high"))
    where = f"95 % interval {low:.1f} to {high:.1f}".replace("-", "\N{MINUS SIGN}")
    if gain["low"] <= 0.0 <= gain["high"]:
        return f"Between {name} and {gain['over']} there is no sure difference ({where} points)"
    more = "more" if points > 0.0 else "less"
    return f"{name} avoids {abs(points):.1f} points {more} than {gain['over']} ({where})"


def _interval(layout: Mapping[str, Any]) -> str:
    return f"{layout['method']}: {percent(layout['low'])} to {percent(layout['high'])}"


def _worlds(count: int) -> str:
    return "world" if count == 1 else "worlds"
