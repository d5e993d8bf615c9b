"""Which engine is started, and what is refused before dask is asked."""

import subprocess
import sys

import pytest
from refusals import refused_with

from experiments.engine.processes import Processes
from experiments.engine.start import EngineWish, memory_bytes, start_engine
from experiments.engine.tasks import Here
from geometry.errors import InputError, MissingExtraError


def start(wish, n_tasks=4):
    """The engine that a wish has started; it has ended."""
    told = []
    with start_engine(wish, n_tasks=n_tasks, tell=told.append) as engine:
        return engine


def test_several_workers_and_tasks_make_processes_and_one_of_either_none():
    several = start(EngineWish(workers=3), n_tasks=2)
    assert isinstance(several, Processes)
    assert several.capacity == 2
    for wish, n_tasks in (
        (EngineWish(workers=1), 9),
        (EngineWish(workers=9), 1),
    ):
        assert isinstance(start(wish, n_tasks), Here)
    assert isinstance(start(EngineWish(workers=4).with_workers(0)), Here)


CUT_OFF = '{"type": "Scheduler", "id": "Scheduler-0", "addr'
EXPECTED = "an address such as tls://10.0.0.1:8786, a scheduler file, or local"


@pytest.mark.parametrize(
    ("scheduler", "said"),
    [
        ("10.0.0.1:8786", f"--scheduler: got '10.0.0.1:8786'; expected {EXPECTED}"),
        (
            "tcp://10.0.0.1:8786",
            "--scheduler: got tcp://10.0.0.1:8786, without TLS: whoever reaches it can"
            " run programs; expected tls://, or --insecure-scheduler as well",
        ),
        ("inproc://1/2", f"--scheduler: got 'inproc://1/2'; expected {EXPECTED}"),
        (
            "cut.json",
            "--scheduler: got cut.json, which is cut off or something else; expected"
            " the whole file that `dask scheduler --scheduler-file` writes",
        ),
        (
            "open.json",
            "--scheduler: got tcp://10.0.0.1:8786, without TLS: whoever reaches it can"
            " run programs; expected tls://, or --insecure-scheduler as well",
        ),
        (
            "none.json",
            "none.json: got No such file or directory; expected a readable file",
        ),
    ],
)
def test_a_scheduler_that_is_none_or_not_safe_is_refused(
    scheduler, said, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cut.json").write_text(CUT_OFF)
    (tmp_path / "open.json").write_text('{"address": "tcp://10.0.0.1:8786"}')

    with refused_with(said):
        start(EngineWish(scheduler=scheduler))


def test_certificates_that_cannot_be_read_are_refused(tmp_path):
    wish = EngineWish(scheduler="tls://10.0.0.1:1", tls_ca=tmp_path / "none.pem")
    with pytest.raises(InputError, match=r"none\.pem: got No such file or directory"):
        start(wish)


def test_dask_that_is_missing_is_one_line(monkeypatch):
    monkeypatch.delitem(sys.modules, "experiments.engine.cluster", raising=False)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match=r"pip install place-rsus\[cluster\]"):
        start(EngineWish(scheduler="local"))


def test_without_a_scheduler_dask_is_not_loaded():
    program = (
        "import sys, experiments.engine.start;"
        "print(any('distributed' in name for name in sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout == "False\n"


def test_memory_is_an_amount_that_a_task_fits_into():
    assert memory_bytes("1.5GiB") == 3 * 2**29
    assert memory_bytes("2 gb") == 2 * 10**9
    assert memory_bytes("314572800") == 300 * 2**20
    for text in ("299MiB", "much", "-1GB", "", "0.25GiB"):
        with pytest.raises(
            InputError, match=r"an amount such as 1\.5GiB, at least 300"
        ):
            memory_bytes(text)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--tls-ca a.pem", "--tls-ca: got it without --scheduler; expected both"),
        (
            "--scheduler-timeout 0 --scheduler local",
            "--scheduler-timeout: got '0'; expected seconds, more than 0",
        ),
        (
            "--scheduler tcp://10.0.0.1:8786",
            "--scheduler: got tcp://10.0.0.1:8786, without TLS: whoever reaches it can"
            " run programs; expected tls://, or --insecure-scheduler as well",
        ),
        (
            "--worker-memory 100MB",
            "--worker-memory: got '100MB'; expected an amount such as 1.5GiB, at least"
            " 300MiB",
        ),
    ],
)
def test_the_command_line_refuses_in_one_line(run, tmp_path, options, said):
    from city_maps import FEW_RUNS_OPTIONS, write_city

    path = write_city(tmp_path)
    command = ("city", path, "--budget", 1, "--out", tmp_path / "city")
    code, out, err = run(*command, *FEW_RUNS_OPTIONS, "--quiet", *options.split())

    assert code == 2
    assert out == ""
    assert err == f"place-rsus: {said}\n"
