"""How cases are laid where the protocol speaks of its own test track: ``data/laying.toml``."""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from geometry.files import Table, load_toml, read_table


@dataclass(frozen=True, slots=True, kw_only=True)
class WayRules:
    """Ways of the VUT and the VRU."""

    start_before_curve_s: float
    max_lane_bend_m: float
    max_lateral_mps2: float
    town_kmh: float
    max_ease_aside_m: float
    max_kerb_step_m: float
    max_skew_deg: float
    max_turn_skew_deg: float
    cyclist_inside_kerb_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ObstructionRules:
    """How far parked cars and walls give way to what stands where the protocol has them."""

    max_aside_m: dict[str, float]  # by the kind of the obstruction
    max_nearer_m: float
    max_back_m: float
    step_m: float
    max_before_m: float
    island_m: float
    max_island_skew_deg: float


@cache
def load_way_rules() -> WayRules:
    """Rules of ways."""
    return read_table(_load_table("ways"), WayRules, "laying.toml: ways")


@cache
def load_obstruction_rules() -> ObstructionRules:
    """Rules of obstructions."""
    return read_table(_load_table("obstructions"), ObstructionRules, "laying.toml: obstructions")


def _load_table(name: str) -> Table:
    table: Table = load_toml(files(__package__) / "data" / "laying.toml")[name]
    return table
