"""How a result was computed, and how to make it again: the last words of the report."""

import math
import re
from collections.abc import Mapping, Sequence

from geometry.notes import Note
from placement.detectors import ResponseDetector
from placement.layout import Layout
from placement.setting import Radio, Setting
from scenarios.aeb import AebRule

from ..results.numbers import count_runs, first_of, joined, percent, several
from .accidents import is_weighted
from .result import EvaluationResult, PlacementResult, Result
from .sampled_worlds import moving_sentence
from .section import Box, Code, Filled, Section, Table

_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_MAX_NAMES = 3


def assumption_sentences(result: Result) -> list[str]:
    """What the map leaves open, the most important first; sites alike share a sentence."""
    groups: dict[tuple[str, ...], list[Note]] = {}
    for index, one in enumerate(result.assumptions):
        key = (one.kind, _NUMBER.sub("#", one.why)) if one.site_ids else (str(index),)
        groups.setdefault(key, []).append(one)
    return [_together(group) for group in groups.values()]


def _together(group: Sequence[Note]) -> str:
    """One sentence; of several with other numbers, these are the lowest and the highest."""
    first = group[0]
    if len(group) == 1:
        return f"{first.what}: {first.why}."
    numbers = [[float(word) for word in _NUMBER.findall(one.why)] for one in group]
    lows_highs = [(min(column), max(column)) for column in zip(*numbers, strict=True)]
    ranges = iter(f"{low:g}" if low == high else f"{low:g} to {high:g}" for low, high in lows_highs)
    why = _NUMBER.sub(lambda _match: next(ranges), first.why)
    names = [site_id for one in group for site_id in one.site_ids]
    return f"{len(names)} sites ({first_of(names, _MAX_NAMES)}): {why}."


def assumptions_section(result: Result, setting: Setting, layouts: Mapping[str, Layout]) -> Section:
    """Assumptions behind the numbers; layouts by display name."""
    axis, rule = setting.axis, setting.rule
    counted = axis.weight[axis.weight > 0.0]
    sampled = None if isinstance(result, EvaluationResult) else result.sampled
    values = {
        "setting": setting,
        "weights": [counted.min(), counted.max()] if is_weighted(axis) else [],
        "n_without": axis.n_runs - len(counted),
        "figures": _figures(setting),
        "is_endless": math.isinf(rule.track_memory_s),
        "latency": latency_words(rule, layouts),
        "weathers": list(dict.fromkeys(run.weather for run in setting.runs)),
        "has_radio": setting.radio != Radio(),
        "moving": moving_sentence(sampled) if sampled is not None and sampled.moving else "",
        "fusion": result.fusion,
        "budget": result.budget if isinstance(result, PlacementResult) else None,
        **{"percent": percent, "count_runs": count_runs, "several": several},
    }
    return Section("assumptions", "How it was computed", [Filled("assumptions.html.j2", values)])


def again_section(result: Result, command: str) -> Section:
    """The command line, how long it took, and with which programs."""
    seconds = [(stage, f"{value:.1f}") for stage, value in result.seconds.items()]
    versions = [*result.versions.items()]
    tables = [
        Table(caption="Time taken", columns=["stage", "seconds"], rows=seconds, numeric=[1]),
        Table(caption="Versions", columns=["what", "version"], rows=versions),
    ]
    columns = Box("beside tables", [Box("", [table]) for table in tables if table.rows])
    return Section("again", "To make it again", [Code(command), columns])


def _figures(setting: Setting) -> str:
    """How many figures of response tables are measured; that of the table where it is another."""
    tables = {one.name: one for one in (setting.detector, setting.table_detector)}.values()
    return "".join(f" {one.figures_words}" for one in tables if isinstance(one, ResponseDetector))


def latency_words(rule: AebRule, layouts: Mapping[str, Layout]) -> str:
    """The rule's latency, then the units that have another of their own, equal ones together."""
    own = []
    for name, layout in layouts.items():
        unit_ids: dict[float, list[str]] = {}
        for unit in layout.units:
            if unit.latency(rule) != rule.latency_s:
                unit_ids.setdefault(unit.latency(rule), []).append(unit.id)
        of = f" of {name}" if len(layouts) > 1 else ""
        for latency_s, ids in sorted(unit_ids.items()):
            who = "every unit" if len(ids) == len(layout.units) > 1 else joined(ids)
            own.append(f"{who}{of} {1000.0 * latency_s:g} ms")
    text = f"{1000.0 * rule.latency_s:g} ms for processing and communication"
    return f"{text}; units with a latency of their own: {'; '.join(own)}." if own else f"{text}."
