"""What a second process compiles while the first one lays runs and builds the table."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from placement import compile_ahead as module
from placement.compile_ahead import compile_ahead

ROOT = Path(__file__).parents[2]
STEPS = ("place", "front_below", "evaluate_layouts")
# The main job needs all of these after its table; a few of the rest stand in for it.
COMPILED = """
from geometry.kernels import is_compiled
from placement.evaluator import pixels
from placement.optimiser import bit_kernels, walk_kernels
from placement.compile_ahead import compile_ahead

kernels = [
    pixels.see,
    walk_kernels.grow,
    walk_kernels.spell_out,
    walk_kernels.cover_rows,
    bit_kernels.add_weights_with_each,
    walk_kernels.tighten_prices,
]
assert not any(map(is_compiled, kernels))
compile_ahead()
print(sum(map(is_compiled, kernels)), "of", len(kernels))
"""


def test_a_made_up_question_goes_through_all_steps(monkeypatch):
    taken = []
    for name in STEPS:
        step = getattr(module, name)

        def take(*args, step=step, name=name, **kwargs):
            taken.append(name)
            return step(*args, **kwargs)

        monkeypatch.setattr(module, name, take)

    monkeypatch.setattr(module, "is_compiled", lambda function: False)
    compile_ahead()

    assert taken == list(STEPS)


def test_nothing_is_answered_where_code_is_kept(monkeypatch):
    monkeypatch.setattr(module, "is_compiled", lambda function: True)
    monkeypatch.setattr(module, "build_setting", None)
    compile_ahead()


@pytest.mark.long
def test_what_the_main_job_needs_is_compiled(tmp_path):
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(tmp_path),
        "PYTHONPATH": str(ROOT),
    }
    done = subprocess.run(
        [sys.executable, "-c", COMPILED],
        env=environment,
        capture_output=True,
        text=True,
    )

    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["6", "of", "6"]
    assert "compiling" not in done.stderr  # the first process tells that it compiles
