"""How a result was computed, and how to make it again: the last words of the report."""

import math
import re
from collections.abc import Mapping, Sequence

from geometry.notes import Note
from placement.detectors import ResponseDetector
from placement.layout import Layout
from placement.setting import Radio, Setting
from scenarios.aeb import AebRule

from ..language import localized, said, say, tr
from ..results.numbers import first_of, grouped, joined, percent
from .accidents import is_weighted
from .result import PlacementResult, Result
from .sampled_worlds import moving_sentence
from .section import Box, Code, Filled, Section, Table

_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_MAX_NAMES = 3


def assumption_sentences(result: Result) -> list[str]:
    """What the map leaves open, the most important first; sites alike share a sentence."""
    groups = grouped(
        ((one.kind, _NUMBER.sub("#", one.why)) if one.site_ids else index, one)
        for index, one in enumerate(result.assumptions)
    )
    return [_together(group) for group in groups.values()]


def _together(group: Sequence[Note]) -> str:
    """One sentence; of several with other numbers, these are the lowest and the highest."""
    first = group[0]
    if len(group) == 1:
        return tr("{what}: {why}.", what=said(first.what), why=said(first.why))
    numbers = [[float(word) for word in _NUMBER.findall(one.why)] for one in group]
    lows_highs = [(min(column), max(column)) for column in zip(*numbers, strict=True)]
    ranges = iter(
        (
            localized(f"{low:g}")
            if low == high
            else tr("{low:g} to {high:g}", low=low, high=high)
        )
        for low, high in lows_highs
    )
    why = _NUMBER.sub(lambda _match: next(ranges), first.why)
    names = [site_id for one in group for site_id in one.site_ids]
    listed = first_of(names, _MAX_NAMES)
    return tr("{n} sites ({names}): {why}.", n=len(names), names=listed, why=said(why))


def assumptions_section(
    result: Result, setting: Setting, layouts: Mapping[str, Layout]
) -> Section:
    """Assumptions behind the numbers; layouts by display name."""
    axis = setting.axis
    rule = setting.rule
    counted = axis.weight[axis.weight > 0.0]
    sampled = result.sampled
    weathers = [*dict.fromkeys(run.weather for run in setting.runs)]
    values = {
        "setting": setting,
        "weights": [counted.min(), counted.max()] if is_weighted(axis) else [],
        "n_without": axis.n_runs - len(counted),
        "detection": said(f"{setting.detector.description}{_figures(setting)}"),
        "sensors": tr(" and ").join(map(said, setting.vut_sensors)),
        "is_endless": math.isinf(rule.track_memory_s),
        "latency": latency_words(rule, layouts),
        "weathers": [said(name) for name in weathers],
        "is_adverse": weathers != ["day"],
        "has_radio": setting.radio != Radio(),
        "moving": (
            moving_sentence(sampled) if sampled is not None and sampled.moving else ""
        ),
        "fusion": result.fusion,
        "budget": result.budget if isinstance(result, PlacementResult) else None,
        "percent": percent,
    }
    filled = Filled("assumptions.html.j2", values)
    return Section("assumptions", tr("How it was computed"), [filled])


def again_section(result: Result, command: str) -> Section:
    """The command line, how long it took, and with which programs."""
    seconds = [
        (said(stage), localized(f"{value:.1f}"))
        for stage, value in result.seconds.items()
    ]
    versions = [*result.versions.items()]
    columns = [tr("stage"), tr("seconds")]
    tables = [
        Table(caption=tr("Time taken"), columns=columns, rows=seconds, numeric=[1]),
        Table(
            caption=tr("Versions"), columns=[tr("what"), tr("version")], rows=versions
        ),
    ]
    boxes = Box("beside tables", [Box("", [table]) for table in tables if table.rows])
    return Section("again", tr("To make it again"), [Code(command), boxes])


def _figures(setting: Setting) -> str:
    """How many figures of response tables are measured; that of the table where it is another."""
    tables = {
        one.name: one for one in (setting.detector, setting.table_detector)
    }.values()
    return "".join(
        f" {one.figures_words}" for one in tables if isinstance(one, ResponseDetector)
    )


def latency_words(rule: AebRule, layouts: Mapping[str, Layout]) -> str:
    """The rule's latency, then the units that have another of their own, equal ones together."""
    own = []
    for name, layout in layouts.items():
        unit_ids = grouped((unit.latency(rule), unit.id) for unit in layout.units)
        for latency_s, ids in sorted(unit_ids.items()):
            if latency_s == rule.latency_s:
                continue
            if len(ids) == len(layout.units) > 1:
                who = tr("every unit")
            else:
                who = joined(ids)
            if len(layouts) > 1:
                who = tr("{units} of {layout}", units=who, layout=name)
            own.append(
                tr(
                    "{units} {latency_ms:g} ms",
                    units=who,
                    latency_ms=1000.0 * latency_s,
                )
            )
    latency_ms = 1000.0 * rule.latency_s
    if not own:
        return tr(
            "{latency_ms:g} ms for processing and communication.", latency_ms=latency_ms
        )
    return say("assumptions.latencies", latency_ms=latency_ms, own="; ".join(own))
