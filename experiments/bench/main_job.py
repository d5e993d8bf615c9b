"""Time of the main job: ``python -m experiments.bench main-job``.

Each call is a process of its own. Processor seconds are told as ratios to references
that are measured in the same run, since a second is another amount of work on each
machine, and on each hour of a shared one.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

# The first line of an answer begins with one of these, see `cli/first_answer.py`.
_FIRST_LINES = ("Found and proven", "Best found")
_N_RAYS = 2_000_000
_SEED = 0
# Each prints the processor seconds of one reference.
_REFERENCES = {
    "importing numpy, scipy and pandas": """
import time
import numpy, scipy.optimize, scipy.sparse, pandas
print(time.process_time())
""",
    "2,000,000 bare Embree rays": f"""
import time
import numpy as np
from geometry.raycast import build_caster
from geometry.study_scene import load_study_scene
scene = load_study_scene()
caster = build_caster(scene.vertices_m, scene.triangles)
rng = np.random.default_rng({_SEED})
eye = np.tile(np.float32([-125.0, 0.0, 8.0]), ({_N_RAYS}, 1))
ways = rng.uniform(-60.0, 60.0, ({_N_RAYS}, 3)).astype(np.float32)
begun = time.process_time()
caster.is_blocked(eye, ways)
print(time.process_time() - begun)
""",
    "one LP by HiGHS": f"""
import time
import numpy as np
from scipy.optimize import linprog
rng = np.random.default_rng({_SEED})
covers = (rng.random((400, 3000)) < 0.05).astype(float)
begun = time.process_time()
linprog(np.ones(3000), A_ub=-covers, b_ub=-np.ones(400), method="highs")
print(time.process_time() - begun)
""",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """One call of a command.

    Attributes
    ----------
    processor_s : float
        Of the process and all that it started. [s]
    wall_s : float
        Until its end. [s]
    first_line_s : float or None
        Until its first lines were out; None: there were none. [s]
    peak_bytes : int
        Most memory of it.
    """

    processor_s: float
    wall_s: float
    first_line_s: float | None
    peak_bytes: int


def time_command(words: list[str], environment: dict[str, str]) -> Timing:
    """Run a command to its end; CalledProcessError if it fails."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begun_s = time.monotonic()
    first_line_s: float | None = None
    with subprocess.Popen(
        words,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if first_line_s is None and line.startswith(_FIRST_LINES):
                first_line_s = time.monotonic() - begun_s
    wall_s = time.monotonic() - begun_s
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, words)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    user_s = after.ru_utime - before.ru_utime
    system_s = after.ru_stime - before.ru_stime
    return Timing(
        processor_s=user_s + system_s,
        wall_s=wall_s,
        first_line_s=first_line_s,
        # The most of any child so far: the first call is the largest.
        peak_bytes=after.ru_maxrss * 1024,
    )


def measure_references() -> dict[str, float]:
    """Processor seconds of each reference, by its name."""
    found = {}
    for name, program in _REFERENCES.items():
        command = [sys.executable, "-c", program]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        found[name] = float(json.loads(done.stdout))
    return found


def measure_main_job(budget: int) -> dict[str, float]:
    """The main job, first (kernels are compiled), cold and warm.

    Returns
    -------
    figures : dict of str to float
        Processor seconds, also as ratios to the references; wall seconds, also until
        the first lines; and the most memory of any call.
    """
    references = measure_references()
    figures = {
        f"main-job: processor s, {name}": value for name, value in references.items()
    }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        environment = os.environ | {
            "PLACE_RSUS_CACHE": str(folder / "cache"),
            "NUMBA_CACHE_DIR": str(folder / "kernels"),
        }
        words = [sys.executable, "-m", "experiments.start", "--budget", str(budget)]
        words += ["--out", str(folder / "out")]
        calls = {"first": words, "cold": [*words, "--no-cache"], "warm": words}
        peak_bytes = 0
        for kind, command in calls.items():
            timing = time_command(command, environment)
            peak_bytes = max(peak_bytes, timing.peak_bytes)
            figures[f"main-job: processor s, {kind}"] = timing.processor_s
            figures[f"main-job: s, {kind}"] = timing.wall_s
            if timing.first_line_s is not None:
                first_s = timing.first_line_s
                figures[f"main-job: s to the first lines, {kind}"] = first_s
            for reference, seconds in references.items():
                ratio = timing.processor_s / seconds
                figures[f"main-job: processor time, {kind} / {reference}"] = ratio
    figures["main-job: peak memory, GiB"] = peak_bytes / 2**30
    return figures
