"""Runs as esmini drives them, and when the bodies touch by its own count."""

import re
import shutil
import subprocess
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from geometry.errors import InputError, Unquoted, refuse
from geometry.scene import Scene
from placement.compute import DEFAULT_COMPUTE, Compute
from scenarios.runs import Run

from ..results.tables import page_of
from .opendrive import to_opendrive
from .openscenario import VRU, VUT, to_openscenario

STEP_S = 0.005
MOST_S = 0.02  # by which a touch may differ from the impact
_AFTER_S = 0.2  # how long bodies drive on behind the impact
_LIMIT_S = 60.0  # for one run
_TOUCH = re.compile(rf"\[(-?\d+\.\d+)\].*Collision between (?:{VUT} and {VRU}|{VRU} and {VUT})\s*$")


@dataclass(frozen=True, slots=True, kw_only=True)
class Driven:
    """A run as esmini drove it."""

    run_id: str
    touch_s: float | None  # when the bodies first touched, after our impact; None: never

    @property
    def agrees(self) -> bool:
        """True if they touched within ``MOST_S`` of the impact."""
        return self.touch_s is not None and abs(self.touch_s) <= MOST_S + 1.0e-9


def find_esmini(program: str = "") -> Path | None:
    """The program that is named, or "esmini" on the path; None: there is none.

    Raises InputError if what is named is no program.
    """
    found = shutil.which(program or "esmini")
    if program and found is None:
        raise InputError("--esmini", program, "the file of a program")
    return None if found is None else Path(found)


def drive_in_esmini(
    runs: Sequence[Run], scene: Scene, program: Path, *, compute: Compute = DEFAULT_COMPUTE
) -> list[Driven]:
    """Drive runs unbraked, without a window, in steps of 5 ms.

    Bodies drive on for 0.2 s behind the impact. Raises InputError if the program fails.
    """
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "roads.xodr").write_text(to_opendrive(None, scene), encoding="utf-8")

        # Before the threads: the library writes the version that is set for all of it.
        paths = [folder / f"{index}.xosc" for index in range(len(runs))]
        for path, run in zip(paths, runs, strict=True):
            text = to_openscenario(run, road_network="roads.xodr", after_s=_AFTER_S)
            path.write_text(text, encoding="utf-8")

        def drive(run: Run, path: Path) -> Driven:
            touch_s = _first_touch_s(program, path)
            return Driven(
                run_id=run.id,
                touch_s=None if touch_s is None else touch_s + float(run.time_s[0]),
            )

        driven = []
        with ThreadPoolExecutor(compute.workers) as pool:
            for number, one in enumerate(pool.map(drive, runs, paths), 1):
                driven.append(one)
                compute.progress("drive in esmini", number, len(runs))
    return driven


def _first_touch_s(program: Path, path: Path) -> float | None:
    """Scenario time of the first touch; None: there is none."""
    log = path.with_suffix(".txt")
    command = [program, "--osc", path, "--headless", "--fixed_timestep", STEP_S, "--collision"]
    command += ["--logfile_path", log, "--disable_stdout"]
    try:
        done = subprocess.run(
            [str(part) for part in command],
            capture_output=True,
            text=True,
            check=False,
            timeout=_LIMIT_S,
            cwd=path.parent,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise InputError(str(program), Unquoted(error), "a program that drives a run") from None
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines() if log.exists() else []
    if done.returncode or not lines:
        why = next((line for line in lines if "error" in line.lower()), f"exit {done.returncode}")
        refuse(str(program), why[:200], "a run driven to its end")
    times_s = [float(match[1]) for line in lines if (match := _TOUCH.search(line))]
    return min(times_s, default=None)


def worst_first(driven: Sequence[Driven]) -> list[Driven]:
    """Runs by how far the touch is from the impact; those that never touch come first."""
    return sorted(driven, key=lambda one: -np.inf if one.touch_s is None else -abs(one.touch_s))


def summarise(driven: Sequence[Driven]) -> str:
    """A sentence: in how many runs the bodies touch in time."""
    n_good = sum(one.agrees for one in driven)
    times = f"within {MOST_S:g} s of the impact."
    return f"In {n_good} of {len(driven)} runs the bodies touch in esmini {times}"


def describe(driven: Sequence[Driven], command: str) -> str:
    """Page of what was driven by a command, in Markdown: runs by when they touch."""
    groups: dict[str, list[str]] = {}
    for one in worst_first(driven):
        off = "never" if one.touch_s is None else f"{round(one.touch_s, 3) + 0.0:.3f}"
        groups.setdefault(off, []).append(one.run_id)
    arms = dict.fromkeys(one.run_id.split("/")[1] for one in driven)
    rows = [
        (
            off,
            *(str(sum(f"/{arm}/" in one for one in ids)) for arm in arms),
            "the others" if off == "0.000" else ", ".join(ids),
        )
        for off, ids in groups.items()
    ]
    return page_of(
        files(__package__) / "esmini.md.j2",
        summary=summarise(driven),
        command=command,
        step_ms=1000.0 * STEP_S,
        heads=("touch after our impact (s)", *(f"from {arm}" for arm in arms), "which"),
        rows=rows,
    )
