"""Gains of one more unit, and of other sensors at the same mounts."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from geometry.catalogue import sensor_kind
from placement.explain.contributions import NextUnit
from placement.explain.other_sensors import OtherSensors
from placement.layout import Layout

from ..results.numbers import percent, points
from ..results.record import says
from .section import Section, Table, tabulate

_NOTHING_GAINED = 0.5e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Exchange:
    """Another sensor model in place of those of the layout, on the detection table."""

    model: Annotated[str, says("Name in the catalogue.")]
    kind: Annotated[Literal["camera", "lidar"], says("Which kind of sensor.")]
    unit: Annotated[str, says("Id of the unit for which it gains most.")]
    horizontal_fov_deg: Annotated[
        float, says("Its field of view there; a varifocal lens is tried at several, in degrees.")
    ]
    yaw_deg: Annotated[float, says("Where that unit then looks; pitch is positive up, in degrees.")]
    pitch_deg: Annotated[
        float, says("Where that unit then looks; pitch is positive up, in degrees.")
    ]
    apr: Annotated[float, says("APR with that unit exchanged alone and turned for the most.")]
    gain: Annotated[float, says("By how much that is higher than without; negative: lower.")]
    extra_eur: Annotated[
        float, says("Price by the catalogue less that of the model in its place, in EUR.")
    ]
    all_units: Annotated[int, says("How many units can be exchanged.")]
    apr_all: Annotated[
        float,
        says("APR with all of them exchanged, each turned for the most, and with none turned."),
    ]
    apr_not_turned: Annotated[
        float,
        says("APR with all of them exchanged, each turned for the most, and with none turned."),
    ]
    extra_all_eur: Annotated[float, says("Extra price of all of them, in EUR.")]


def build_exchanges(layout: Layout, found: OtherSensors) -> tuple[Exchange, ...]:
    """Other models at the mounts of a layout: what they gain, and what they cost more."""
    return tuple(
        Exchange(
            model=other.sensor.name,
            kind="lidar" if sensor_kind(other.sensor) == "lidar" else "camera",
            unit=other.one.id,
            horizontal_fov_deg=other.one.sensor.horizontal_fov_deg,
            yaw_deg=round(other.one.pose.yaw_deg, 6),
            pitch_deg=round(other.one.pose.pitch_deg, 6),
            apr=round(other.apr_one, 12),
            gain=round(other.apr_one - found.apr, 12),
            extra_eur=other.sensor.price_eur - layout.units[other.unit_index].sensor.price_eur,
            all_units=len(other.all),
            apr_all=round(other.apr_all, 12),
            apr_not_turned=round(other.apr_not_turned, 12),
            extra_all_eur=sum(
                other.sensor.price_eur - unit.sensor.price_eur
                for unit in layout.units
                if unit.id in {pose.id for pose in other.all}
            ),
        )
        for other in found.models
    )


def next_unit_sentence(unit: NextUnit | None, measure: str) -> str:
    """Gain of one more unit, of an "APR" or a "score"; empty where none fits."""
    if unit is None:
        return ""
    how = "on the detection table, by greedy choice"
    if unit.gain < _NOTHING_GAINED:
        return f"One more unit among the candidates would avoid nothing more ({how})"
    return (
        f"One more unit would add {points(unit.gain)} of {measure}: {percent(unit.apr)} with "
        f"{unit.pose} ({how})"
    )


def other_sensor_sentence(exchanges: Sequence[Exchange], measure: str) -> str:
    """Gain of another sensor in place of one of the units; empty where none was tried."""
    if not exchanges:
        return ""
    best = exchanges[0]
    how = "on the detection table, at the same mounts, turned by up to 45 deg"
    if best.gain < _NOTHING_GAINED:
        many = len(exchanges) > 1
        others = f"None of {len(exchanges)} other models" if many else "No other model"
        loss = (
            "the best of them would change nothing"
            if best.gain > -_NOTHING_GAINED
            else f"{_words(best)} would come closest, with {percent(best.apr)}"
        )
        return f"{others} in place of one of these would add anything: {loss} ({how})"
    return (
        f"{_words(best)} would add {points(best.gain)} of {measure}: {percent(best.apr)} for "
        f"{_eur(best.extra_eur)} ({how})"
    )


def _words(exchange: Exchange) -> str:
    return (
        f"{exchange.model} ({exchange.horizontal_fov_deg:g} deg wide) in place of {exchange.unit}"
    )


def _eur(more: float) -> str:
    if more == 0.0:
        return "the same money"
    return f"{abs(more):,.0f} EUR {'more' if more > 0.0 else 'less'}"


def words(unit: NextUnit | None, exchanges: Sequence[Exchange], measure: str) -> list[str]:
    """Both in sentences; nothing where neither is known."""
    said = (next_unit_sentence(unit, measure), other_sensor_sentence(exchanges, measure))
    return [f"{sentence}." for sentence in said if sentence]


def section(unit: NextUnit | None, exchanges: Sequence[Exchange], measure: str) -> Section | None:
    """One more unit, and other sensors at the same mounts; None where neither is known."""
    sentences = words(unit, exchanges, measure)
    if not sentences:
        return None
    tables = [table(exchanges)] if exchanges else []
    title = "What the next unit or a longer lens buys"
    return Section("next-unit", title, [" ".join(sentences), *tables])


def table(exchanges: Sequence[Exchange]) -> Table:
    """A row per model."""
    return tabulate(
        "Other models of the catalogue at the mounts of this layout, on the detection "
        "table: in place of the unit for which they gain most, turned by up to 45 degrees and "
        "tilted so that the middle or the upper edge of the picture stays; and in place of all "
        "units, turned one after the other, or not turned",
        exchanges,
        {
            "model": lambda one: one.model,
            "field of view (deg)": lambda one: f"{one.horizontal_fov_deg:g}",
            "in place of": lambda one: one.unit,
            "APR": lambda one: percent(one.apr),
            "points more": lambda one: f"{100.0 * one.gain:+.1f}",
            "EUR more": lambda one: f"{one.extra_eur:+,.0f}",
            "APR, all exchanged": lambda one: percent(one.apr_all),
            "not turned": lambda one: percent(one.apr_not_turned),
            "EUR more, all": lambda one: f"{one.extra_all_eur:+,.0f}",
        },
        numeric=(1, *range(3, 9)),
    )
