"""Registry of the sources of vehicles that drive by, and what all of them tell."""

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Annotated, Any, Protocol

import numpy as np

from geometry.errors import InputError
from geometry.registry import load_entry
from geometry.scene import Scene
from geometry.tables import says
from scenarios.runs import Run

SOURCES = {
    "sumo": "placement.sampling.moving.sumo:load_default_traffic",
    ".toml": "placement.sampling.moving.sumo:load_traffic_of_file",
}
"""Sources of moving traffic by name, or by the suffix of a file of demand.

Each entry is a :class:`TrafficEntry`.
"""


@dataclass(frozen=True, slots=True)
class TrafficCount:
    """Vehicles that drive by, in all runs together."""

    n_runs: Annotated[int, says("Number of runs.")] = 0
    n_vehicles: Annotated[
        int, says("Near the junction, those left out among them.")
    ] = 0
    n_left_out: Annotated[
        int, says("Of these: they would have come into the way of VUT or VRU.")
    ] = 0
    n_departed: Annotated[int, says("By SUMO: entered the network.")] = 0
    n_waiting: Annotated[int, says("By SUMO: found no room to.")] = 0

    def __add__(self, other: "TrafficCount") -> "TrafficCount":
        return TrafficCount(*map(sum, zip(astuple(self), astuple(other), strict=True)))

    def __str__(self) -> str:
        text = (
            f"{self.n_left_out} of {self.n_vehicles} vehicles in {self.n_runs} runs"
            " left out: they would have been in the way"
        )
        if self.n_waiting:
            n_wanted = self.n_departed + self.n_waiting
            text += f"; SUMO found no room for {self.n_waiting} of {n_wanted} vehicles"
        return text


# Nobody drives by.
NO_TRAFFIC = TrafficCount()


class MovingTraffic(Protocol):
    """Where vehicles that drive by come from."""

    @property
    def name(self) -> str:
        """Name in reports."""

    def draw(
        self,
        runs: Sequence[Run],
        groups: Mapping[Any, Sequence[int]],
        *,
        frame_s: float,
        clearance_m: float,
        rng: np.random.Generator,
    ) -> tuple[tuple[Run, ...], TrafficCount]:
        """Runs with the vehicles that drive by in one world, see :class:`.SumoTraffic`.

        Raises InputError where there is too little traffic, MissingExtraError where a
        library is missing.
        """


class TrafficEntry(Protocol):
    """An entry of ``SOURCES``."""

    def __call__(self, source: str, scene: Scene) -> MovingTraffic:
        """Vehicles on a scene's lanes, as a question names them.

        Raises InputError if the source is not what it should be, MissingExtraError if a
        library is missing.
        """


def load_traffic(source: str, scene: Scene) -> MovingTraffic:
    """Vehicles that drive by, as a question names them.

    The name is "sumo", or a .toml file of demand for it. Raises InputError if it is
    not what it should be; MissingExtraError without SUMO.
    """
    if source in SOURCES:
        key = source
    else:
        key = Path(source).suffix.lower()
    if key not in SOURCES:
        expected = "sumo, or a .toml file of demand for it"
        raise InputError("traffic", source, expected)
    load: TrafficEntry = load_entry(SOURCES[key])
    return load(source, scene)
