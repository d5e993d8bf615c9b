"""How a result was computed, and how to make it again.

The last words of the report.
"""

import math
from collections.abc import Mapping, Sequence

from geometry.notes import Note
from geometry.phrases import Phrase
from placement.layout import Layout
from placement.setting import Radio, Setting
from scenarios.aeb import AebRule

from ..language import localized, tr
from ..results.numbers import first_of, grouped, joined, percent
from .accidents import is_weighted
from .result import PlacementResult, Result
from .sampled_worlds import moving_sentence
from .section import Box, Code, Filled, Section, Table

_MAX_NAMES = 3


def assumption_sentences(result: Result) -> list[str]:
    """What the map leaves open, the most important first.

    Sites alike share a sentence.
    """
    groups = grouped(
        ((one.kind, _but_for_numbers(one.why)) if one.site_ids else index, one)
        for index, one in enumerate(result.assumptions)
    )
    return [_together(group) for group in groups.values()]


def _but_for_numbers(why: str) -> str:
    """What is the same in reasons that differ in their numbers alone."""
    if not isinstance(why, Phrase):
        return why
    same = {
        name: "#" if isinstance(value, int | float) else value
        for name, value in why.fields.items()
    }
    return f"{why.template} {same}"


def _together(group: Sequence[Note]) -> str:
    """One sentence out of several that differ in their numbers.

    The numbers become the lowest and the highest.
    """
    first = group[0]
    if len(group) == 1:
        return tr("{what}: {why}.", what=tr(first.what), why=tr(first.why))
    why = tr(first.why)
    if isinstance(first.why, Phrase):
        whys = [one.why for one in group if isinstance(one.why, Phrase)]
        ranges = {
            name: _Range([one.fields[name] for one in whys])
            for name, value in first.why.fields.items()
            if isinstance(value, int | float)
        }
        why = tr(Phrase(first.why.template, **{**first.why.fields, **ranges}))
    names = [site_id for one in group for site_id in one.site_ids]
    listed = first_of(names, _MAX_NAMES)
    return tr("{n} sites ({names}): {why}.", n=len(names), names=listed, why=why)


class _Range:
    """The lowest and the highest of numbers, rounded as a format says."""

    def __init__(self, numbers: Sequence[float]) -> None:
        self._low = min(numbers)
        self._high = max(numbers)

    def __format__(self, spec: str) -> str:
        low = float(format(self._low, spec))
        high = float(format(self._high, spec))
        if low == high:
            return localized(f"{low:g}")
        return tr("{low:g} to {high:g}", low=low, high=high)


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
        "detection": _detection_words(setting),
        "sensors": tr(" and ").join(map(tr, setting.vut_sensors)),
        "is_endless": math.isinf(rule.track_memory_s),
        "latency": latency_words(rule, layouts),
        "weathers": [tr(name) for name in weathers],
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
        (tr(stage), localized(f"{value:.1f}"))
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
    return Section("again", tr("Reproduce this result"), [Code(command), boxes])


def _detection_words(setting: Setting) -> str:
    """When the detector detects, and how much of its tables is measured."""
    words = [setting.detector.description, *_figures(setting)]
    return " ".join(tr(sentence) for sentence in words)


def _figures(setting: Setting) -> list[Phrase]:
    """How many figures of response tables are measured.

    That of the table where it is another.
    """
    tables = {one.name: one for one in (setting.detector, setting.table_detector)}
    return [one.figures_words for one in tables.values() if one.figures_words]


def latency_words(rule: AebRule, layouts: Mapping[str, Layout]) -> str:
    """The rule's latency, then units with a latency of their own.

    Equal ones are told together.
    """
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
    return tr(
        "{latency_ms:g} ms for processing and communication; units with a "
        "latency of their own: {own}.",
        latency_ms=latency_ms,
        own="; ".join(own),
    )
