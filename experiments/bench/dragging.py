"""How long a drag on the planner's page takes until its numbers are known, beside a new mount."""

import json
import statistics
import time
from collections.abc import Callable

from placement.candidates import CandidatePose
from placement.live import LiveTable, table_verdict
from placement.setting import Setting

from ..plan.numbers import state_record, table_numbers
from ..plan.session import ChangeUnit, Stock, Variant, begin_history, change_state
from ..study.layout import load_carlancap_layout
from .rays import Figures

_TURNS, _LIFTS = 60, 12
_UNITS = 3


def measure_dragging(setting: Setting) -> Figures:
    """Processor time from a message of the browser to the text of its answer, by the table.

    Three of the study's cameras hang; one of them is turned and tilted, then raised. Until the
    numbers come: the change, what the plan draws, detections, verdicts of each unit and of all.
    """
    units = load_carlancap_layout().units[:_UNITS]
    stock = Stock(scene=setting.scene, models={unit.sensor.name: unit.sensor for unit in units})
    history = begin_history([Variant(name="three", units=units)])
    live = LiveTable(setting)

    def answer(change: ChangeUnit) -> str:
        nonlocal history
        state = change_state(history.state, change, stock)
        history = history.went_on(state, gesture="bench")
        drawn = state_record(history, setting.scene)
        return json.dumps([drawn, _numbers(live, state.variant.units, setting)])

    unit = units[0]
    low_m, high_m = next(
        site.height_range_m.tolist() for site in setting.scene.sites if site.id == unit.site_id
    )
    answer(ChangeUnit(unit=unit.id, yaw_deg=0.0))  # all is loaded, and all mounts are cast from
    turns = [
        _seconds(answer, ChangeUnit(unit=unit.id, yaw_deg=6.0 * n, pitch_deg=-5.0 - 0.5 * n))
        for n in range(1, _TURNS + 1)
    ]
    lifts = [
        _seconds(
            answer,
            ChangeUnit(unit=unit.id, height_m=low_m + (high_m - low_m) * (n + 0.5) / _LIFTS),
        )
        for n in range(_LIFTS)
    ]
    return {
        "dragging: runs": str(setting.axis.n_runs),
        "dragging: a turn, ms of processor time, median": 1000.0 * statistics.median(turns),
        "dragging: a turn, ms of processor time, 95 of 100": 1000.0 * _most(turns),
        "dragging: a new mount, ms of processor time, median": 1000.0 * statistics.median(lifts),
        "dragging: a new mount, ms of processor time, the worst": 1000.0 * max(lifts),
        "dragging: a new mount to a turn": statistics.median(lifts) / statistics.median(turns),
    }


def _numbers(live: LiveTable, units: tuple[CandidatePose, ...], setting: Setting) -> object:
    detected = live.detected(units)
    alone = {
        unit.id: table_verdict([unit], detected[row : row + 1], setting)
        for row, unit in enumerate(units)
    }
    return table_numbers(units, table_verdict(units, detected, setting), alone, setting)


def _seconds(answer: Callable[[ChangeUnit], str], change: ChangeUnit) -> float:
    began_s = time.process_time()
    answer(change)
    return time.process_time() - began_s


def _most(seconds: list[float]) -> float:
    """What 95 of 100 do not exceed."""
    return statistics.quantiles(seconds, n=20)[-1]
