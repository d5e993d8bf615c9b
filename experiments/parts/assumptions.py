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
from .section import Box, Code, Section, Table, Terms

_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_MAX_NAMES = 3
_MOVING = (
    "In each sampled world, runs of one case, approach and position see the same traffic, with the "
    "impact at the same moment. Vehicles more than 100 m from the middle of the junction are cut. "
    "Who would touch what is parked, or come nearer to car or road user than the clearance, is "
    "left out of that run. Where SUMO drives, its vehicles react to the car, which minds no lights."
)
_FUSIONS = {
    "any": "A frame counts if any unit detects the road user in it.",
    "single": "One unit must confirm the road user by itself.",
}


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
    terms = assumptions(result, setting, layouts)
    return Section("assumptions", "How it was computed", [Terms(terms)])


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


def assumptions(
    result: Result, setting: Setting, layouts: Mapping[str, Layout]
) -> list[tuple[str, str]]:
    """Assumptions behind the numbers, as term and text; layouts by display name."""
    rule, axis = setting.rule, setting.axis
    cars = ""
    if setting.cars:
        who = "every car" if setting.cars == 1.0 else f"{percent(setting.cars)} of the cars"
        cars = f" That is one more unit of {who}, which costs nothing and never fails."
    onset = f"reached linearly {rule.build_up_s:g} s after the onset"
    if rule.build_up_s == 0.0:
        onset = "constant from the onset"
    weathers = list(dict.fromkeys(run.weather for run in setting.runs))
    dims = " It takes contrast from cameras and pulses from LiDARs."
    terms = {
        "Runs": f"{axis.n_runs} runs, {axis.n_frames} frames at {rule.frame_rate_hz:g} Hz. Every "
        "run ends in an impact unless the car brakes. One frame falls on the moment of the impact.",
        "Weights": _weights(setting),
        "Detection": f"{setting.detector.description}{_figures(setting)} The car itself looks "
        f"with: {' and '.join(setting.vut_sensors)}.{cars}",
        "Confirmation": f"{rule.n_confirmations} detected frames in a row, "
        f"{1.0 / rule.frame_rate_hz:g} s apart.",
        "Tracks": _tracks(rule),
        "Latency": _latency(rule, layouts),
        "Braking": f"{rule.deceleration_mps2:g} m/s\N{SUPERSCRIPT TWO}, {onset}, along the car's "
        "path. The road user keeps going.",
        "Avoided": "The outlines of car and road user on the road never touch.",
        "Weather": f"{', '.join(weathers)}.{'' if weathers == ['day'] else dims}",
    }
    if setting.radio != Radio():
        terms["Radio"] = _radio(setting.radio)
    sampled = None if isinstance(result, EvaluationResult) else result.sampled
    if sampled is not None and sampled.moving:
        terms["Traffic"] = f"{moving_sentence(sampled)}. {_MOVING}"
    terms["Units together"] = _FUSIONS[result.fusion]
    if isinstance(result, PlacementResult) and result.budget is not None:
        terms["Budget"] = several(result.budget, "unit", "units") + "."
    return [*terms.items()]


def _figures(setting: Setting) -> str:
    """How many figures of response tables are measured; that of the table where it is another."""
    tables = {one.name: one for one in (setting.detector, setting.table_detector)}.values()
    return "".join(f" {one.figures_words}" for one in tables if isinstance(one, ResponseDetector))


def _tracks(rule: AebRule) -> str:
    """How long a confirmed road user stays known, and what the car brakes for."""
    if math.isinf(rule.track_memory_s):
        return (
            "A road user who is confirmed once stays known for ever, however long nobody detects "
            "them: the CarlaNCAP study's reading."
        )
    return (
        f"A confirmed road user stays known for {rule.track_memory_s:g} s after each detection, "
        "then must be confirmed anew. The car brakes only for one who is known at the last moment "
        "to brake, less the latency. Time to spare counts from the confirmation of that track on."
    )


def _latency(rule: AebRule, layouts: Mapping[str, Layout]) -> str:
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


def _weights(setting: Setting) -> str:
    axis = setting.axis
    if not is_weighted(axis):
        return "Every run counts the same."
    counted = axis.weight[axis.weight > 0.0]
    low, high = (percent(float(share)) for share in (counted.min(), counted.max()))
    text = f"Runs count differently: from {low} to {high} of the whole each."
    n_without = axis.n_runs - len(counted)
    if n_without:
        verb = "is" if n_without == 1 else "are"
        text += f" {count_runs(n_without)} of weight 0 {verb} driven, but not counted."
    return text


def _radio(links: Radio) -> str:
    lost = f"{percent(links.packet_loss)} of all messages are lost, frame by frame."
    if links.vam_rate == 0.0:
        return lost
    return (
        f"{lost} {percent(links.vam_rate)} of the road users announce themselves (VRU awareness "
        "messages), and the car trusts the position that they send."
    )
