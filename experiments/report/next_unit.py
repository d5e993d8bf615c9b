"""What the next unit or a longer lens buys."""

from collections.abc import Sequence

from ..parts.section import Section, Table
from ..results.baselines import ExchangeRecord
from ..results.numbers import percent, points
from ..results.result import Result

_NOTHING_GAINED = 0.5e-9


def next_unit_sentence(result: Result) -> str:
    """What one more unit would buy; empty where nothing was optimised, or none fits."""
    if not result.next_unit:
        return ""
    unit = result.next_unit
    how = "on the detection table, by greedy choice"
    if unit.gain < _NOTHING_GAINED:
        return f"One more unit among the candidates would avoid nothing more ({how})"
    return (
        f"One more unit would add {points(unit.gain)} of APR: {percent(unit.apr)} with "
        f"{unit.pose} ({how})"
    )


def other_sensor_sentence(result: Result) -> str:
    """What another sensor in place of one of the units would buy; empty where none was tried."""
    if not result.other_sensors:
        return ""
    best = result.other_sensors[0]
    how = "on the detection table, at the same mounts, turned by up to 45 deg"
    if best.gain < _NOTHING_GAINED:
        many = len(result.other_sensors) > 1
        others = f"None of {len(result.other_sensors)} other models" if many else "No other model"
        loss = (
            "the best of them would change nothing"
            if best.gain > -_NOTHING_GAINED
            else f"{_words(best)} would come closest, with {percent(best.apr)}"
        )
        return f"{others} in place of one of these would add anything: {loss} ({how})"
    return (
        f"{_words(best)} would add {points(best.gain)} of APR: {percent(best.apr)} for "
        f"{_eur(best.extra_eur)} ({how})"
    )


def _words(exchange: ExchangeRecord) -> str:
    return (
        f"{exchange.model} ({exchange.horizontal_fov_deg:g} deg wide) in place of {exchange.unit}"
    )


def _eur(more: float) -> str:
    if more == 0.0:
        return "the same money"
    return f"{abs(more):,.0f} EUR {'more' if more > 0.0 else 'less'}"


def next_unit_section(result: Result) -> Section | None:
    """One more unit, and other sensors at the same mounts; None where neither is known."""
    said = [next_unit_sentence(result), other_sensor_sentence(result)]
    sentences = [f"{sentence}." for sentence in said if sentence]
    if not sentences:
        return None
    tables = [_table(result.other_sensors)] if result.other_sensors else []
    return Section(
        "next-unit", "What the next unit or a longer lens buys", [" ".join(sentences), *tables]
    )


def _table(exchanges: Sequence[ExchangeRecord]) -> Table:
    return Table(
        caption="Other models of the catalogue at the mounts of this layout, on the detection "
        "table: in place of the unit for which they do most, turned by up to 45 degrees and tilted "
        "so that the middle or the upper edge of the picture stays; and in place of all units, "
        "turned one after the other, or as they hang",
        columns=[
            "model",
            "field of view (deg)",
            "in place of",
            "APR",
            "points more",
            "EUR more",
            "APR, all exchanged",
            "as they hang",
            "EUR more, all",
        ],
        rows=[
            [
                exchange.model,
                f"{exchange.horizontal_fov_deg:g}",
                exchange.unit,
                percent(exchange.apr),
                f"{100.0 * exchange.gain:+.1f}",
                f"{exchange.extra_eur:+,.0f}",
                percent(exchange.apr_all),
                percent(exchange.apr_as_they_hang),
                f"{exchange.extra_all_eur:+,.0f}",
            ]
            for exchange in exchanges
        ],
        numeric=(1, *range(3, 9)),
    )
