"""One simulation of SUMO in a process of its own: ``python child.py INPUT.json OUTPUT.npz``.

libsumo holds one simulation per process, and brings libraries that must not meet those
of its caller: this file imports nothing of the toolkit. It reads and writes what
:mod:`.sumo` says.
"""

import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

if __name__ == "__main__":  # whoever else imports this file may lack SUMO
    import libsumo
    from libsumo import constants

VUT = "vut"
_EXACT_MAPPING = 2  # keepRoute: where it is put, on whichever lane lies there
_SPEED_AS_SET = 0  # speedMode: no safe gap, no right of way, no red light


def simulate(job: dict[str, Any]) -> dict[str, Any]:
    """Drive through all windows of a job; returns samples, types and counts."""
    step_s = job["step_s"]
    libsumo.start(
        [
            *(
                "sumo",
                "-n",
                job["network"],
                "-r",
                job["routes"],
                "--seed",
                str(job["seed"]),
            ),
            *("--step-length", repr(step_s), "--no-step-log", "--no-warnings"),
            # By default vehicles jump from lane to lane within one step.
            *("--lanechange.duration", "3", "--collision.action", "none"),
            *("--xml-validation", "never"),
            *("--duration-log.disable", "--random-depart-offset", "0"),
        ]
    )
    rows: list[tuple[float, ...]] = []
    number: dict[str, int] = {}
    types: list[str] = []
    n_departed = now = 0
    if job["vut"] is not None:
        libsumo.vehicletype.copy(job["first_type"], VUT)
        for name in ("Length", "Width", "Height"):
            getattr(libsumo.vehicletype, f"set{name}")(VUT, job["vut"][name.lower()])
    for index, window in enumerate(job["windows"]):
        while now < window["first_step"]:
            libsumo.simulationStep()
            n_departed += _others(libsumo.simulation.getDepartedIDList())
            now += 1
        wanted = [constants.VAR_POSITION, constants.VAR_ANGLE]
        libsumo.junction.subscribeContext(
            job["junction"], constants.CMD_GET_VEHICLE_VARIABLE, job["reach_m"], wanted
        )
        vut = _Vut(f"{VUT}.{index}", window["vut"])
        while now < window["last_step"]:
            vut.move(now + 1)
            libsumo.simulationStep()
            n_departed += _others(libsumo.simulation.getDepartedIDList())
            now += 1
            near = libsumo.junction.getContextSubscriptionResults(job["junction"])
            for vehicle, values in near.items():
                if vehicle == vut.id:
                    continue
                if vehicle not in number:
                    number[vehicle] = len(types)
                    types.append(libsumo.vehicle.getTypeID(vehicle))
                east, north = values[constants.VAR_POSITION]
                rows.append(
                    (number[vehicle], now, east, north, values[constants.VAR_ANGLE])
                )
        vut.remove()
        libsumo.junction.unsubscribeContext(
            job["junction"], constants.CMD_GET_VEHICLE_VARIABLE, job["reach_m"]
        )
    n_waiting = _others(libsumo.simulation.getPendingVehicles())
    libsumo.close()
    return {
        "samples": np.array(rows, dtype=np.float64).reshape(-1, 5),
        "types": np.array(types, dtype=np.str_),
        "n_departed": n_departed,
        "n_waiting": n_waiting,
    }


def _others(vehicles: Iterable[str]) -> int:
    """How many vehicles are not the one under test."""
    return sum(not name.startswith(f"{VUT}.") for name in vehicles)


class _Vut:
    """The vehicle under test in one window."""

    def __init__(self, name: str, drive: dict[str, Any] | None) -> None:
        self.id = name
        self.drive = drive
        self.is_there = False

    def move(self, step: int) -> None:
        """Put it where it is after the coming step, if it has set off by then."""
        if self.drive is None or step < self.drive["first_step"]:
            return
        row = step - self.drive["first_step"]
        if row >= len(self.drive["front_m"]):
            return
        if not self.is_there:
            route = f"{self.id}.{step}"
            libsumo.route.add(route, self.drive["edges"])
            libsumo.vehicle.add(self.id, route, typeID=VUT)
            libsumo.vehicle.setSpeedMode(self.id, _SPEED_AS_SET)
            libsumo.vehicle.setLaneChangeMode(self.id, 0)
            self.is_there = True
        east, north = self.drive["front_m"][row]
        try:
            libsumo.vehicle.setSpeed(self.id, self.drive["speed_mps"])
            libsumo.vehicle.moveToXY(
                self.id,
                "",
                -1,
                east,
                north,
                self.drive["angle_deg"][row],
                _EXACT_MAPPING,
            )
        except (
            libsumo.TraCIException
        ):  # no lane within 100 m, or it has driven off the network
            self.remove()

    def remove(self) -> None:
        """Take it off the road, if it is there."""
        if self.is_there and self.id in libsumo.vehicle.getIDList():
            libsumo.vehicle.remove(self.id)
        self.is_there = False


if __name__ == "__main__":
    found = simulate(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))
    np.savez(sys.argv[2], **found)
