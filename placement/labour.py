"""What it costs to re-aim or to remove a unit that hangs already."""

from dataclasses import dataclass
from importlib.resources import files

from geometry.errors import InputError
from geometry.toml_files import load_toml, pick, take_number, take_text

_FILE = "labour.toml"
_NUMBERS = ("people", "wage_eur_per_h", "travel_h", "lift_eur", "re_aim_h", "remove_h")


@dataclass(frozen=True, slots=True, kw_only=True)
class Labour:
    """People and a lift: prices without hardware.

    Attributes
    ----------
    people : float
        At work together.
    wage_eur_per_h : float
        Of each, on the way, too. [EUR/h]
    travel_h : float
        There and back. [h]
    lift_eur : float
        For the visit. [EUR]
    re_aim_h, remove_h : float
        At the pole. [h]
    source : str
        Where the numbers come from.
    """

    people: float
    wage_eur_per_h: float
    travel_h: float
    lift_eur: float
    re_aim_h: float
    remove_h: float
    source: str

    def __post_init__(self) -> None:
        for field in _NUMBERS:
            if not getattr(self, field) >= 0.0:
                raise InputError(f"labour.{field}", getattr(self, field), "at least 0")

    @property
    def re_aim_eur(self) -> float:
        """To turn a unit on its pole, in euros."""
        return self._visit_eur(self.re_aim_h)

    @property
    def remove_eur(self) -> float:
        """To take a unit down, in euros."""
        return self._visit_eur(self.remove_h)

    def _visit_eur(self, at_pole_h: float) -> float:
        return self.people * self.wage_eur_per_h * (self.travel_h + at_pole_h) + self.lift_eur


def load_labour(name: str = "default") -> Labour:
    """Labour prices by name, from ``data/labour.toml``.

    Examples
    --------
    >>> load_labour().re_aim_eur
    505.0
    """
    table = pick(load_toml(files(__package__) / "data" / _FILE), name, _FILE)
    where = f"{_FILE}: {name}"
    return Labour(
        **{key: take_number(table, key, where) for key in _NUMBERS},
        source=take_text(table, "source", where),
    )
