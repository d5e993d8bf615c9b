"""The basis of a result.

Cases, weathers, perception, refused runs, versions of programs.
"""

import platform
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from typing import Annotated

from geometry.raycast import caster_name
from geometry.weather import pick_weather
from placement.detectors.geometric import GeometricDetector
from placement.setting import Setting
from scenarios.positions import AT_ZERO
from scenarios.runs import Refusal

from ..language import tr, trn
from .numbers import capital, count_runs, finite_or_none, grouped, joined
from .record import Record, Share, says

_PACKAGES = ("cvxpy", "highspy", "numpy", "scipy", "trimesh")
_RAY_PACKAGES = {"open3d": ("open3d-cpu", "open3d"), "embree": ("embreex",)}
# From there no camera of the catalogue sees a road user 40 px high.
_FARTHEST_M = 300.0
_AS_THEY_ARE = ("approach", "position", "reason", "is_possible")
# That the first sentence names.
_MOST_GAPS = 6


class RefusalRecord(Record, frozen=True, kw_only=True):
    """A case that the scene has no room for."""

    case: Annotated[str, says("Name of the case.")]
    approach: Annotated[str, says("Arm from which the vehicle would come.")]
    position: Annotated[str, says("Where along the arms: 0, -15, +15 and so on.")] = "0"
    speeds_kmh: Annotated[tuple[float, ...], says("Speeds of the vehicle, in km/h.")]
    reason: Annotated[str, says("Why, in words.")]
    is_possible: Annotated[
        bool, says("Only room is missing: it counts as possible.")
    ] = True


class DrivesRecord(Record, frozen=True, kw_only=True):
    """Runs that were driven, and how they were perceived.

    Fields of every result.
    """

    cases: Annotated[tuple[str, ...], says("Names of the cases that were driven.")]
    weathers: Annotated[tuple[str, ...], says("Weathers that were driven in.")]
    detector: Annotated[str, says("What detects: name.")]
    vut_sensors: Annotated[tuple[str, ...], says("Sensors of the vehicle under test.")]
    cars: Annotated[
        Share, says("Of cars whose own sensors are one more unit (--cars).")
    ] = 0.0
    packet_loss: Annotated[Share, says("Share of the units' messages that get lost.")]
    vam_rate: Annotated[
        Share, says("Share of the road users that announce themselves.")
    ]
    track_memory_s: Annotated[
        float | None,
        says(
            "How long a confirmed track lives without detections, in seconds; null: for"
            " ever."
        ),
    ]
    not_driven: Annotated[
        tuple[RefusalRecord, ...], says("What has no room in the scene.")
    ]
    possible_runs: Annotated[
        int, says("Runs driven, and those that lack only room.", ge=1)
    ]
    driven: Annotated[tuple[str, ...], says("What possible runs are missing, and why.")]
    without_effect: Annotated[
        tuple[str, ...], says("What changes nothing, in words.")
    ] = ()


def build_drives_record(setting: Setting) -> DrivesRecord:
    """Cases, weathers, perception and refusals of a setting.

    Cases and weathers are there once, in the order of the runs.
    """
    return DrivesRecord(
        cases=tuple(dict.fromkeys(setting.axis.cases)),
        weathers=tuple(dict.fromkeys(setting.axis.weathers)),
        detector=setting.detector.name,
        vut_sensors=tuple(setting.vut_sensors),
        cars=setting.cars,
        packet_loss=setting.radio.packet_loss,
        vam_rate=setting.radio.vam_rate,
        track_memory_s=finite_or_none(setting.rule.track_memory_s),
        not_driven=tuple(
            RefusalRecord(
                case=one.case.name,
                speeds_kmh=tuple(one.speeds_kmh),
                **{name: getattr(one, name) for name in _AS_THEY_ARE},
            )
            for one in setting.refusals
        ),
        possible_runs=_count_possible(setting),
        driven=tuple(describe_driven(setting)),
        without_effect=tuple(_without_effect(setting)),
    )


def _without_effect(setting: Setting) -> Iterator[str]:
    """Wishes that change nothing: light, for a detector that knows none."""
    detector = setting.detector
    if not isinstance(detector, GeometricDetector):
        return
    alike = []
    for name in dict.fromkeys(setting.axis.weathers):
        weather = pick_weather(name, "run: weather")
        contrast = weather.contrast * float(weather.transmission(_FARTHEST_M))
        if name != "day" and contrast >= detector.min_contrast:
            alike.append(name)
    if alike:
        names = [tr(name) for name in alike]
        yield trn(
            "{weathers} has no effect on cameras here: the {detector} detector does"
            " not model light. --detector response does.",
            "{weathers} have no effect on cameras here: the {detector} detector does"
            " not model light. --detector response does.",
            len(alike),
            weathers=capital(joined(names)),
            detector=detector.name,
        )


def describe_driven(setting: Setting) -> list[str]:
    """What is missing of the possible runs, and why.

    A line per reason, if anything is. The first line has the main reason.
    """
    limits = [*describe_limits(setting), *describe_left_out(setting)]
    lacking = lacking_room(setting)
    if not lacking:
        return limits
    n_runs = setting.axis.n_runs
    n_possible = _count_possible(setting)
    reasons = _by_reason(setting)
    gaps = list(_gaps(setting))
    n_left = len(gaps) - _MOST_GAPS
    if n_left > 0:
        gaps = [*gaps[:_MOST_GAPS], tr("{n} more below", n=n_left)]
    # Nothing that could be driven is missing; what the map rules out still is.
    if n_runs == n_possible:
        first = tr("All {n} runs that this junction allows are simulated.", n=n_runs)
    else:
        first = tr(
            "{n} of {all} possible runs are simulated. The main reason why others are"
            " not: {reason}.",
            n=n_runs,
            all=n_possible,
            reason=_reason_words(reasons[0][0]),
        )
    if gaps:
        first += " " + tr("Not simulated: {gaps}.", gaps="; ".join(gaps))
    return [first, *_reasons(setting, reasons), *limits]


def describe_limits(setting: Setting) -> list[str]:
    """How many runs the map's speed limits leave out, and which limits.

    Nothing where none is.
    """
    found = [one for one in setting.refusals if one.limit_kmh is not None]
    if not found:
        return []
    arms = grouped((f"{one.limit_kmh:g} km/h", tr(one.approach)) for one in found)
    where = [
        tr("{limit} from the {arms}", limit=limit, arms=joined(dict.fromkeys(names)))
        for limit, names in arms.items()
    ]
    return [
        trn(
            "Left out: {n} run of the protocol above the map's speed limits, {where}"
            " (--speeds all includes it).",
            "Left out: {n} runs of the protocol above the map's speed limits,"
            " {where} (--speeds all includes them).",
            _count_speeds(found) * _n_weathers(setting),
            where=joined(where),
        )
    ]


def lacking_room(setting: Setting) -> list[Refusal]:
    """Refusals for want of roads or room.

    Speed limits, and whom cases meet, are other reasons.
    """
    return [
        one
        for one in setting.refusals
        if one.limit_kmh is None and one.left_out not in ("unprotected", "not laid")
    ]


def describe_left_out(setting: Setting) -> Iterator[str]:
    """Cases that meet somebody unprotected, and cases laid nowhere."""
    names = unprotected_cases(setting)
    if names:
        yield trn(
            "Only vulnerable road users are protected: {cases} does not count"
            " because the target is a car (--protect all also counts cars).",
            "Only vulnerable road users are protected: {cases} do not count because"
            " the target is a car (--protect all also counts cars).",
            len(names),
            cases=joined(names),
        )
    not_laid = [one for one in setting.refusals if one.left_out == "not laid"]
    reasons = grouped((one.reason, one.case.name) for one in not_laid)
    if reasons:
        listed = [
            f"{joined(dict.fromkeys(names))}: {tr(why).removesuffix('.')}"
            for why, names in reasons.items()
        ]
        yield tr("Not simulated at any junction: {cases}.", cases="; ".join(listed))


def unprotected_cases(setting: Setting) -> list[str]:
    """Names of cases left out since whoever is met is not protected."""
    found = [one.case.name for one in setting.refusals if one.left_out == "unprotected"]
    return list(dict.fromkeys(found))


def _count_possible(setting: Setting) -> int:
    """Runs that are driven, or would be if there were room."""
    refused = sum(len(one.speeds_kmh) for one in setting.refusals if one.is_possible)
    return setting.axis.n_runs + refused * _n_weathers(setting)


def _n_weathers(setting: Setting) -> int:
    return len(set(setting.axis.weathers))


def _gaps(setting: Setting) -> Iterator[str]:
    """Cases that are not driven at all or not from everywhere.

    The widest gaps first.
    """
    driven = dict.fromkeys((run.case.name, run.approach) for run in setting.runs)
    for_speed = {run.case.name for run in setting.runs}
    refused = {(one.case.name, one.approach): one for one in lacking_room(setting)}
    missing = {pair: one for pair, one in refused.items() if pair not in driven}
    nowhere = [name for name, _ in missing if name not in for_speed]
    if nowhere:
        yield tr("{cases} anywhere", cases=joined(dict.fromkeys(nowhere)))
    left = {
        pair: one
        for pair, one in missing.items()
        if pair[0] not in nowhere and one.is_possible
    }
    from_arms = {arm for _, arm in driven}
    silent = dict.fromkeys(arm for _, arm in left if arm not in from_arms)
    if silent:
        yield tr("any case from the {arms}", arms=joined(map(tr, silent)))
    kinds = {run.case.name: run.case.vru.class_name for run in setting.runs}
    met = {(kinds[name], arm) for name, arm in driven}
    # Of a kind, or of a case; name; arms.
    told = grouped(
        ((False, name) if (kinds[name], arm) in met else (True, kinds[name]), tr(arm))
        for name, arm in left
        if arm not in silent
    )
    for is_kind, name in sorted(told, key=lambda what: not what[0]):
        arms = joined(dict.fromkeys(told[is_kind, name]))
        if is_kind:
            yield tr("{kind} cases from the {arms}", kind=tr(name), arms=arms)
        else:
            yield tr("{case} from the {arms}", case=name, arms=arms)


def _by_reason(setting: Setting) -> list[tuple[str, list[Refusal]]]:
    """Refusals for want of roads or room by reason, those of most runs first.

    What is not possible comes last.
    """
    groups = grouped((one.reason, one) for one in lacking_room(setting))
    return sorted(
        groups.items(),
        key=lambda item: (not item[1][0].is_possible, -_count_speeds(item[1])),
    )


def _count_speeds(group: Sequence[Refusal]) -> int:
    """Runs that some refusals take away in each weather."""
    return sum(len(one.speeds_kmh) for one in group)


def _reason_words(reason: str) -> str:
    """A reason within a sentence."""
    return tr(reason).removesuffix(".")


def _reasons(
    setting: Setting, reasons: Sequence[tuple[str, Sequence[Refusal]]]
) -> Iterator[str]:
    """A line per reason, in their order."""
    for reason, group in reasons:
        places = grouped((one.case.name, (one.approach, one.position)) for one in group)
        cases = grouped(
            (describe_places(grouped(where)), name) for name, where in places.items()
        )
        where = [
            tr("{cases} from the {places}", cases=joined(names), places=found)
            for found, names in cases.items()
        ]
        values = {
            "runs": count_runs(_count_speeds(group) * _n_weathers(setting)),
            "reason": _reason_words(reason),
            "where": "; ".join(where),
        }
        if group[0].is_possible:
            yield tr("{runs}: {reason} ({where}).", **values)
        else:
            yield tr("Not possible, {runs}: {reason} ({where}).", **values)


def describe_places(positions: Mapping[str, Sequence[str]]) -> str:
    """Positions by arm, in words; position 0 goes without saying.

    Examples
    --------
    >>> describe_places({"east": ["0"], "north": ["0", "0"]})
    'east and north'
    >>> both = ["-30", "-45"]
    >>> describe_places({"east": both, "north": both, "west": ["+45"]})
    'east and north (at -30, -45) and west (at +45)'
    """
    arms: dict[str, list[str]] = {}
    for arm, found in positions.items():
        names = list(dict.fromkeys(found))
        if names == [AT_ZERO.name]:
            where = ""
        else:
            where = ", ".join(names)
        arms.setdefault(where, []).append(tr(arm))
    return joined(
        [
            (
                tr("{arms} (at {positions})", arms=joined(found), positions=where)
                if where
                else joined(found)
            )
            for where, found in arms.items()
        ]
    )


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    rays = caster_name()
    found = {"place-rsus": version("place-rsus"), "python": platform.python_version()}
    found |= {name: version(name) for name in _PACKAGES}
    for package in _RAY_PACKAGES[rays]:
        try:
            found[f"rays: {rays}"] = version(package)
            break
        except ModuleNotFoundError:
            continue
    return found
