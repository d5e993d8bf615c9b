"""The result of a retrofit: the best change of every kind to a layout that hangs."""

from typing import Literal

from placement.retrofit import Labour

from .drives import RefusalRecord
from .record import Record, StageRecord, UnitRecord


class RetrofitValueRecord(Record, frozen=True, kw_only=True):
    """What a layout is worth on the detection table."""

    apr: float
    apr_one_failed: float
    smallest_margin_s: float
    mean_margin_s: float


class ActionRecord(Record, frozen=True, kw_only=True):
    """What is done to one unit."""

    action: Literal["remove", "re-aim", "add"]
    unit: str
    words: str


class ChangeRecord(Record, frozen=True, kw_only=True):
    """A change, its price, what it gains and loses, and what hangs afterwards."""

    actions: tuple[ActionRecord, ...]
    price_eur: float
    apr: float
    apr_one_failed: float
    smallest_margin_s: float
    mean_margin_s: float
    gained: tuple[str, ...]
    lost: tuple[str, ...]
    is_better: bool
    is_proven: bool
    compared: int
    stages: tuple[StageRecord, ...]
    solver: str | None
    layout: tuple[UnitRecord, ...]


class LabourRecord(Record, frozen=True, kw_only=True):
    """People and a lift: prices without hardware, and the price of a visit."""

    people: float
    wage_eur_per_h: float
    travel_h: float
    lift_eur: float
    re_aim_h: float
    remove_h: float
    source: str
    re_aim_eur: float


class RetrofitResult(Record, frozen=True, kw_only=True):
    """What can be done about a layout: ``retrofit.json``, and what ``--json`` prints."""

    name: str
    layout: tuple[UnitRecord, ...]
    before: RetrofitValueRecord
    candidates: int
    removals: tuple[ChangeRecord, ...]
    re_aims: tuple[ChangeRecord, ...]
    addition: ChangeRecord | None
    combination: ChangeRecord | None
    runs: int
    fusion: str
    budget_eur: float | None
    labour: LabourRecord
    command: str
    cases: tuple[str, ...]
    weathers: tuple[str, ...]
    detector: str
    vut_sensors: tuple[str, ...]
    packet_loss: float
    vam_rate: float
    track_memory_s: float | None = None
    not_driven: tuple[RefusalRecord, ...]
    possible_runs: int
    driven: tuple[str, ...]
    without_effect: tuple[str, ...] = ()
    sentences: tuple[str, ...]
    seconds: dict[str, float]
    versions: dict[str, str]


def build_labour_record(labour: Labour) -> LabourRecord:
    """Prices of labour, with that of a re-aim."""
    return LabourRecord(
        people=labour.people,
        wage_eur_per_h=labour.wage_eur_per_h,
        travel_h=labour.travel_h,
        lift_eur=labour.lift_eur,
        re_aim_h=labour.re_aim_h,
        remove_h=labour.remove_h,
        source=labour.source,
        re_aim_eur=labour.re_aim_eur,
    )
