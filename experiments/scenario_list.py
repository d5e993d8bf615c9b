"""Cases by approach, as rows and as a table for a terminal."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from placement.driving import Drives

_WIDTH = 80


def list_rows(drives: Drives) -> list[dict[str, Any]]:
    """One row per case and approach.

    Parameters
    ----------
    drives : Drives
        Runs, and what cannot be driven.

    Returns
    -------
    rows : list of dict
        ``{"case", "approach", "speeds_kmh", "n_runs", "last_brake_time_s", "reason"}``: one last
        brake time per speed, relative to the impact, None where braking cannot help; the reason
        is None where every speed is driven.
    """
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    # By case in the order asked for: what is refused stands beside what is driven.
    order = {run.case.name: None for run in drives.runs}

    def row(case: str, approach: str) -> dict[str, Any]:
        empty: dict[str, Any] = {
            "case": case,
            "approach": approach,
            "speeds_kmh": [],
            "n_runs": 0,
            "last_brake_time_s": [],
            "reason": None,
        }
        order.setdefault(case)
        return rows.setdefault((case, approach), empty)

    for run in drives.runs:
        entry = row(run.case.name, run.approach)
        entry["n_runs"] += 1
        if run.vut_speed_kmh not in entry["speeds_kmh"]:
            last_s = run.last_brake_time_s
            entry["speeds_kmh"].append(run.vut_speed_kmh)
            entry["last_brake_time_s"].append(last_s if np.isfinite(last_s) else None)
    for refusal in (*drives.refused, *drives.left_out):
        entry = row(refusal.case.name, refusal.approach)
        is_partly = set(refusal.speeds_kmh) != set(refusal.case.vut_speeds_kmh)
        speeds = ", ".join(f"{speed:g}" for speed in refusal.speeds_kmh)
        reason = f"at {speeds} km/h: {refusal.reason}" if is_partly else refusal.reason
        entry["reason"] = reason if entry["reason"] is None else f"{entry['reason']}; {reason}"
    cases = list(order)
    return sorted(rows.values(), key=lambda entry: cases.index(entry["case"]))


def scenario_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows as a table, at most 80 columns wide."""
    lines = [f"{'case':<13} {'from':<11} {'km/h':<8} {'runs':>4}  last moment to brake (s)"]
    previous = ""
    for entry in rows:
        case = entry["case"] if entry["case"] != previous else ""
        previous = entry["case"]
        lines.append(
            f"{case:<13} {entry['approach']:<11} {_span(entry['speeds_kmh'], 'g'):<8} "
            f"{entry['n_runs']:>4}  {_last_moments(entry)}".rstrip()
        )
        if entry["reason"] is not None:
            lines += textwrap.wrap(
                f"not driven: {entry['reason']}",
                _WIDTH,
                initial_indent=" " * 14,
                subsequent_indent=" " * 16,
            )
    n_runs = sum(entry["n_runs"] for entry in rows)
    n_cases = len({entry["case"] for entry in rows})
    lines.append(f"{n_runs} runs of {n_cases} case" + ("s" if n_cases != 1 else ""))
    return "\n".join(lines)


def _last_moments(entry: Mapping[str, Any]) -> str:
    times = entry["last_brake_time_s"]
    known = sorted(time for time in times if time is not None)
    text = _span(known[::-1], ".2f")
    if len(known) < len(times):
        return f"{text}, {len(times) - len(known)} x never".removeprefix(", ")
    return text


def _span(values: Sequence[float], form: str) -> str:
    if not values:
        return ""
    low, high = f"{values[0]:{form}}", f"{values[-1]:{form}}"
    return low if low == high else f"{low} to {high}" if form != "g" else f"{low}-{high}"
