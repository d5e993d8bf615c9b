"""Workers of a dask scheduler: who may use it, who is believed, what is lost.

Each starts processes that load dask, for seconds of processor time: all are long. The
quick tests of the same are those of the seam, and of what is refused before dask loads.
"""

import re
import time
from contextlib import contextmanager

import pytest

pytest.importorskip("distributed")

import engine_tasks as tasks
from dask_cluster import dask_processes, write_certificates

from experiments.engine import cluster as job
from experiments.engine.start import EngineWish, start_engine
from experiments.engine.tasks import WorkerDiedError
from geometry.errors import InputError

pytestmark = [
    pytest.mark.long,
    pytest.mark.filterwarnings("ignore"),  # those of dask
]


def wish_for(cluster, **more):
    """What is wished for to use the workers of a cluster."""
    _, file, _, authority, _, own = cluster.options
    given = {"scheduler": str(file), "tls_ca": authority, "tls_cert": own}
    return EngineWish(**(given | more))


@contextmanager
def engine_of(wish, told=None):
    """The engine that a wish starts; what it says is kept in `told`."""
    tell = (told if told is not None else []).append
    with start_engine(wish, n_tasks=4, tell=tell) as engine:
        yield engine


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Two workers behind TLS."""
    with dask_processes(tmp_path_factory.mktemp("cluster"), n=2) as started:
        yield started


@pytest.fixture(scope="module")
def engine(cluster):
    with engine_of(wish_for(cluster)) as started:
        yield started


def test_answers_are_those_of_this_process_and_shared_values_are_sent_once(engine):
    expected = {number: number * number for number in range(20)}
    assert tasks.answers_of(engine, tasks.square, range(20)) == expected

    before = engine.n_shared_bytes
    shared = (b"x" * 1_000_000,)
    found = tasks.answers_of(engine, bytes.count, [b"x", b"y", b"xx"], shared=shared)

    assert found == {b"x": 1_000_000, b"y": 0, b"xx": 500_000}
    assert engine.n_shared_bytes - before < 1_001_000


def test_a_task_that_kills_its_workers_is_told_and_takes_no_other_with_it(engine):
    found = tasks.answers_of(
        engine, tasks.end_at_3, range(6), failed=lambda task, error: type(error)
    )
    assert found == {
        0: 0,
        1: 1,
        2: 4,
        3: WorkerDiedError,
        4: 16,
        5: 25,
    }


def test_of_workers_that_die_at_work_nothing_is_lost(engine, cluster):
    those = iter(range(30))

    def killing():
        for number in those:
            if number in (6, 12):
                cluster.kill_a_worker(number // 12)
            yield number

    expected = {number: number * number for number in range(30)}

    assert tasks.answers_of(engine, tasks.square, killing()) == expected


def test_errors_are_tried_thrice_unless_nobody_can_answer(engine, tmp_path):
    shared = (tmp_path,)
    with pytest.raises(ValueError, match="invalid literal"):
        tasks.answers_of(engine, tasks.count_calls, ["x"], shared=shared)
    with pytest.raises(InputError, match="here: got 'refused'; expected a number"):
        tasks.answers_of(engine, tasks.count_calls, ["refused"], shared=shared)
    assert len(list(tmp_path.glob("x-*"))) == 3
    assert len(list(tmp_path.glob("refused-*"))) == 1


def test_certificates_of_others_are_refused_in_one_line(cluster, tmp_path):
    theirs, stranger = write_certificates(tmp_path, "other")
    for given in (
        {"tls_ca": theirs, "tls_cert": stranger},
        {"tls_cert": stranger},
        {"tls_ca": theirs},
        {"tls_ca": stranger.with_name("other.pem"), "tls_cert": theirs},
    ):
        with (
            pytest.raises(InputError, match=r"^--scheduler: got tls://") as caught,
            engine_of(wish_for(cluster, **given)),
        ):
            pass
        assert str(caught.value).endswith(
            "expected the address of a running dask scheduler, and its certificates"
        )
        assert "\n" not in str(caught.value)
    with (
        pytest.raises(InputError, match="--tls-ca: got nothing; expected files of"),
        engine_of(wish_for(cluster, tls_cert=None)),
    ):
        pass


def test_an_address_where_nobody_listens_is_one_line(cluster, monkeypatch):
    monkeypatch.setattr(job, "CONNECT_S", 1.0)
    said = r"got tls://127\.0\.0\.1:9: Timed out trying to connect .* after 1 s; exp"
    with (
        pytest.raises(InputError, match=said),
        engine_of(wish_for(cluster, scheduler="tls://127.0.0.1:9")),
    ):
        pass


def test_a_scheduler_without_workers_is_waited_for_and_then_told(tmp_path):
    told = []
    with dask_processes(tmp_path, n=0) as empty:
        said = r", without workers for 2 s; expected a scheduler with workers, or mo"
        with (
            pytest.raises(InputError, match=said),
            engine_of(wish_for(empty, scheduler_timeout=2.0), told),
        ):
            pass
        address = empty.address()
    assert told == [f"Waiting for workers of {address}, at most 2 s."]


OTHER_PROGRAM = """
from experiments.engine import cluster
cluster.program = lambda: "place-rsus 0.0.9 (code 0123, Python 3.11.0)"
"""


def test_workers_with_another_program_are_refused_before_and_after(tmp_path):
    preload = tmp_path / "other.py"
    preload.write_text(OTHER_PROGRAM)
    with dask_processes(tmp_path, n=1, more=("--preload", preload)) as cluster:
        said = (
            r"--scheduler: got tls://127\.0\.0\.1:\d+ with place-rsus 0\.0\.9 \(code"
            r" 0123, Python 3\.11\.0\); expected scheduler and workers with place-rsus"
        )
        with pytest.raises(InputError, match=said), engine_of(wish_for(cluster)):
            pass

        # One that joins later finds the plugin, and never serves.
        cluster.stop_workers()
        cluster.start_worker()
        told = []
        with engine_of(wish_for(cluster), told) as engine:
            cluster.start_worker("--preload", preload)
            until_s = time.monotonic() + 60.0
            while not told[-1:] or "0.0.9" not in told[-1]:
                assert time.monotonic() < until_s
                time.sleep(0.1)
            found = tasks.answers_of(engine, tasks.square, range(9))

            assert found == {number: number * number for number in range(9)}

            while len(engine._client.nthreads()) > 1:  # it leaves
                assert time.monotonic() < until_s
                time.sleep(0.1)

    assert re.match(said, told[-1])


def test_an_answer_of_another_program_ends_all(engine, monkeypatch):
    known = job.program()
    monkeypatch.setattr(job, "program", lambda: "place-rsus 2 (code 0, Python 4)")
    with pytest.raises(InputError) as caught:
        tasks.answers_of(engine, tasks.square, [1])

    said = f"a worker with {known}; expected scheduler and workers with place-rsus 2"
    assert said in str(caught.value)


def test_a_scheduler_with_another_program_or_none_is_refused(tmp_path):
    preload = tmp_path / "other.py"
    preload.write_text("import sys\nsys.modules['experiments.engine.cluster'] = None\n")
    begin = ("--preload", preload)
    with dask_processes(tmp_path, n=1, of_scheduler=begin) as cluster:
        said = "got a scheduler with ModuleNotFoundError: import of experiments.eng"
        with pytest.raises(InputError, match=said), engine_of(wish_for(cluster)):
            pass


def test_a_scheduler_that_dies_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(job, "CONNECT_S", 3.0)
    with dask_processes(tmp_path, n=1) as cluster:

        def killing():
            yield 1
            yield 2
            cluster.scheduler.kill()
            yield from range(3, 9)

        said = "which does not answer any more; expected a running scheduler; the same"
        with (
            pytest.raises(InputError, match=said),
            engine_of(wish_for(cluster)) as engine,
        ):
            tasks.answers_of(engine, tasks.square, killing())
