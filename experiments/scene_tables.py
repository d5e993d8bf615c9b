"""Scenes as plain text for a terminal, at most 80 columns wide."""

import textwrap
from typing import Any

_WIDTH = 80
_MAX_LISTED = 20


def scene_text(summary: dict[str, Any]) -> str:
    """What a scene or a map has.

    Parameters
    ----------
    summary : dict
        By :mod:`experiments.scene_jobs`.
    """
    side = "left" if summary["keeps_left"] else "right"
    lines = textwrap.wrap(
        f"{summary['name']}: {_count(len(summary['junctions']), 'junction')}, "
        f"{_count(summary['buildings'], 'building')}, {_count(summary['things'], 'thing')} in all, "
        f"{_count(summary['sites'], 'site')}, {_count(summary['crosswalks'], 'crosswalk')}; "
        f"traffic keeps {side}; coordinates: {summary['crs'] or 'of no known place'}",
        _WIDTH,
    )
    lines += ["", *_junction_lines(summary)]
    if "site_list" in summary:
        lines += ["", *_site_lines(summary["site_list"])]
    if summary["skipped"]:
        lines += ["", "Left out, or assumed:"]
        for entry in summary["skipped"][:_MAX_LISTED]:
            lines += _wrapped(f"{entry['what']}: {entry['why']}")
        lines += _more(len(summary["skipped"]))
    if "written" in summary:
        lines += ["", f"Written to {summary['written']}."]
    return "\n".join(lines)


def findings_text(summary: dict[str, Any]) -> str:
    """What may be wrong with a scene."""
    if not summary["findings"]:
        return f"{summary['name']}: nothing found."
    lines = [f"{summary['name']}:"]
    for finding in summary["findings"]:
        lines += _wrapped(f"{finding['level']}: {finding['what']}: {finding['why']}")
    return "\n".join(lines)


def _junction_lines(summary: dict[str, Any]) -> list[str]:
    junctions = summary["junctions"]
    if len(junctions) == 1 and "arm_list" in junctions[0]:
        lines = [f"  {'arm':<20} {'lanes in':>9} {'lanes out':>10} {'parking':>8}"]
        lines += [
            f"  {arm['name']:<20} {arm['lanes_in']:>9} {arm['lanes_out']:>10} "
            f"{arm['parking_lanes']:>8}"
            for arm in junctions[0]["arm_list"]
        ]
        return lines
    if not junctions:
        return ["  no junctions"]
    lines = [f"  {'junction':<18} {'arms':>4} {'lanes':>5} {'x':>13} {'y':>13}  name"]
    lines += [
        f"  {_short(one['id'], 18):<18} {one['arms']:>4} {one['lanes']:>5} "
        f"{one['x_m']:>13.6f} {one['y_m']:>13.6f}  {_short(one['name'], 18)}".rstrip()
        for one in junctions[:_MAX_LISTED]
    ]
    return lines + _more(len(junctions))


def _site_lines(sites: list[dict[str, Any]]) -> list[str]:
    lines = [f"  {'site':<26} {'kind':<14} {'x m':>8} {'y m':>8} {'mount m':>11} {'units':>5}"]
    for site in sites[:_MAX_LISTED]:
        low, high = site["height_range_m"]
        lines.append(
            f"  {_short(site['id'], 26):<26} {_short(site['kind'], 14):<14} {site['x_m']:8.1f} "
            f"{site['y_m']:8.1f} {f'{low:g} to {high:g}':>11} {site['capacity_units']:>5}"
        )
    return lines + _more(len(sites))


def _more(count: int) -> list[str]:
    left = count - _MAX_LISTED
    return [f"  and {left} more: --json"] if left > 0 else []


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def _short(text: str, width: int) -> str:
    return text if len(text) <= width else text[: width - 1] + "\N{HORIZONTAL ELLIPSIS}"


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(
        text, _WIDTH, initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False
    )
