"""Tasks on the workers of a dask scheduler, an existing one or one of this machine.

Workers, and the scheduler, need the same program as the one that sends the tasks: they
load functions and values by their names. Nothing runs for somebody who has no
credentials, see :func:`connect` and :func:`start_local`.
"""

import logging
import pickle
import ssl
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager, suppress
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from platform import python_version
from typing import Any
from uuid import uuid4

import dask
from distributed import (
    Client,
    KilledWorker,
    LocalCluster,
    Security,
    Worker,
    WorkerPlugin,
)

from geometry.errors import InputError, Unquoted
from placement.fingerprints import ALL_PACKAGES, hash_of_code

from ..language import tr
from .tasks import LEAST_BYTES, TRIES, Engine, WorkerDiedError

CONNECT_S = 10.0
"""A scheduler answers within so many seconds."""

_WHERE = "--scheduler"
_PLUGIN = "place-rsus"
# Topic under which dask tells why.
_RESTARTED = "worker-restart-memory"
# Workers are counted as often.
_LOOK_S = 2.0
_SETTINGS = {
    "distributed.admin.large-graph-warning-threshold": "1TB",  # shared values are large
    # A process that is paused for its memory never goes on if that does not shrink.
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 1.0,
    "distributed.worker.profile.enabled": False,
    # dask would close a worker for good that restarts at the wrong moment.
    "distributed.deploy.lost-worker-timeout": "100 days",
    # The worker of a task dies as often as a task is tried elsewhere.
    "distributed.scheduler.allowed-failures": TRIES - 1,
    # HTTP knows no credentials: what it would tell and do is left out.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}


class Cluster(Engine):
    """Workers of a dask scheduler."""

    # Dask tries again.
    tries = 1

    def __init__(
        self,
        client: Client,
        address: str,
        *,
        timeout_s: float,
        tell: Callable[[str], None],
    ) -> None:
        super().__init__()
        self._client = client
        self._address = address
        self._timeout_s = timeout_s
        self._tell = tell
        self._sent: dict[Future[Any], Any] = {}
        # A reference each, so that no other value gets its id.
        self._shared: dict[int, tuple[object, Any]] = {}
        self._looked_s = 0.0
        # Since when there is no worker; 0: there are some.
        self._alone_since_s = 0.0

    def submit(
        self, function: Callable[..., Any], shared: tuple[Any, ...], task: Any
    ) -> "Future[Any]":
        """Hand a task to the scheduler."""
        future: Future[Any] = Future()
        arguments = (self.payload(function, task), *map(self._share, shared))
        self._hand_over(future, function.__name__, arguments, TRIES)
        return future

    def watch(self) -> None:
        """Count the workers; InputError if there have been none for too long."""
        now_s = time.monotonic()
        if now_s - self._looked_s < _LOOK_S:
            return
        self._looked_s = now_s
        try:
            threads = self._client.nthreads()
        except (OSError, RuntimeError, ValueError, TypeError, CancelledError):
            raise self._lost() from None
        self.capacity = max(sum(threads.values()), 1)
        if threads:
            self._alone_since_s = 0.0
        elif not self._alone_since_s:
            self._alone_since_s = now_s
            self._tell_of_waiting()
        elif now_s - self._alone_since_s > self._timeout_s:
            raise self._no_workers()

    def begin(self) -> None:
        """Wait for workers, and refuse another program, theirs or the scheduler's."""
        if not self._client.nthreads():
            self._tell_of_waiting()
        try:
            self._client.wait_for_workers(1, timeout=self._timeout_s)
        except TimeoutError:
            raise self._no_workers() from None
        self._check_memory()
        try:
            of_scheduler = self._client.run_on_scheduler(program)
        except Exception as error:  # whatever its Python says
            of_scheduler = error
        programs = {"a scheduler": of_scheduler}
        programs |= self._client.run(program, on_error="return")
        for where, theirs in programs.items():
            if isinstance(theirs, Exception):
                theirs = " ".join(f"{type(theirs).__name__}: {theirs}".split())[:160]
            if theirs != program():
                raise _other_program(where, theirs, program())
        self._client.subscribe_topic(_PLUGIN, lambda event: self._tell(event[1]))
        self._client.register_plugin(SameProgram(program()), name=_PLUGIN)
        self.watch()

    def end(self) -> None:
        """Give up what is left, and ask no worker for this program any more."""
        # The scheduler may have gone.
        with suppress(Exception):
            self._client.cancel([*self._sent.values()])
        with suppress(Exception):
            self._client.unregister_worker_plugin(_PLUGIN)

    def _share(self, value: object) -> Any:
        """A value on the workers.

        It is a task of its own: what is lost is sent again.
        """
        if id(value) not in self._shared:
            future = self._client.submit(
                pickle.loads, self.shared_payload(value), key=f"shared-{uuid4().hex}"
            )
            self._shared[id(value)] = (value, future)
        return self._shared[id(value)][1]

    def _hand_over(
        self, future: "Future[Any]", name: str, arguments: tuple[Any, ...], left: int
    ) -> None:
        sent = self._client.submit(
            _call,
            *arguments,
            key=f"{name}-{uuid4().hex}",
            retries=TRIES - 1,
            pure=False,
        )
        self._sent[future] = sent
        again = partial(self._hand_over, future, name, arguments, left - 1)
        sent.add_done_callback(partial(self._end, future, again if left > 1 else None))

    def _end(
        self, future: "Future[Any]", again: Callable[[], None] | None, sent: Any
    ) -> None:
        """Pass an answer on; called by a thread of dask."""
        try:
            theirs, is_answer, answer = sent.result()
        except KilledWorker as error:
            is_answer, answer = False, WorkerDiedError(self._death(error))
        except CancelledError:
            is_answer, answer = False, self._lost()
        except Exception as error:  # whatever it is, `map_tasks` decides
            is_answer, answer = False, error
        else:
            if theirs != program():
                if again is not None:
                    again()
                    return
                is_answer = False
                answer = _other_program("a worker", theirs, program())
        del self._sent[future]
        if is_answer:
            future.set_result(answer)
        else:
            future.set_exception(answer)

    def _check_memory(self) -> None:
        """Refuse workers that would die of their limit at the first task."""
        workers = self._client.scheduler_info(n_workers=-1)["workers"]
        for worker, known in workers.items():
            # 0: none.
            limit_bytes = known["memory_limit"]
            if 0 < limit_bytes < LEAST_BYTES:
                raise InputError(
                    _WHERE,
                    Unquoted(f"{worker} with {limit_bytes >> 20} MiB of memory"),
                    f"workers with at least {LEAST_BYTES >> 20} MiB each",
                )

    def _death(self, error: KilledWorker) -> str:
        """Of what the worker of a task died last, if dask knows."""
        events = self._client.get_events(_RESTARTED)
        if error.last_worker.pid in {event["pid"] for _, event in events}:
            return "more memory than it may take"
        return ""

    def _tell_of_waiting(self) -> None:
        self._tell(
            tr(
                "Waiting for workers of {scheduler}, at most {seconds:g} s.",
                scheduler=self._address,
                seconds=self._timeout_s,
            )
        )

    def _lost(self) -> InputError:
        return InputError(
            _WHERE,
            Unquoted(f"{self._address}, which does not answer any more"),
            "a running scheduler; the same command goes on",
        )

    def _no_workers(self) -> InputError:
        return InputError(
            _WHERE,
            Unquoted(f"{self._address}, without workers for {self._timeout_s:g} s"),
            "a scheduler with workers, or more --scheduler-timeout",
        )


@contextmanager
def connect(
    address: str,
    *,
    ca: Path | None,
    certificate: Path | None,
    key: Path | None,
    timeout_s: float,
    tell: Callable[[str], None],
) -> Iterator[Cluster]:
    """Workers of an existing scheduler; files of PEM are those of the command line.

    Where none is named, dask's own configuration says which ones, as for its
    ``dask worker``.

    Raises
    ------
    InputError
        Nobody answers, certificates are wrong, there are no workers, or one of them has
        another program.
    """
    named = {
        "tls_ca_file": ca,
        "tls_client_cert": certificate,
        "tls_client_key": key or certificate,
    }
    is_encrypted = address.startswith("tls://")
    security = Security(
        require_encryption=is_encrypted,
        **{name: str(path) for name, path in named.items() if path},
    )
    if is_encrypted and not (security.tls_ca_file and security.tls_client_cert):
        raise InputError(
            "--tls-ca", Unquoted("nothing"), "files of --tls-ca and --tls-cert"
        )
    with _connected(address, security) as client:
        yield from _served(client, address, timeout_s, tell)


@contextmanager
def start_local(
    n: int,
    *,
    max_bytes: int,
    timeout_s: float,
    tell: Callable[[str], None],
) -> Iterator[Cluster]:
    """Processes of this machine behind a scheduler of their own.

    It listens at 127.0.0.1 alone, and answers to nobody without the credentials, which
    are made for this call and are in no file.
    """
    security = Security.temporary()
    with (
        tempfile.TemporaryDirectory(prefix="place-rsus-") as folder,
        dask.config.set(_SETTINGS),
        LocalCluster(
            n_workers=n,
            threads_per_worker=1,
            memory_limit=max_bytes,
            host="127.0.0.1",
            protocol="tls://",
            security=security,
            dashboard_address=None,
            scheduler_kwargs={
                "dashboard": False,
                "dashboard_address": "127.0.0.1:0",
            },
            local_directory=folder,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        _connected(cluster.scheduler_address, security) as client,
    ):
        yield from _served(client, "local", timeout_s, tell)


@contextmanager
def _connected(address: str, security: Security) -> Iterator[Client]:
    # Errors are told by us.
    for name in [*logging.root.manager.loggerDict]:
        if name.startswith(("distributed", "tornado")):
            logging.getLogger(name).setLevel(logging.CRITICAL)
    with dask.config.set(_SETTINGS):
        try:
            client = Client(
                address,
                security=security,
                timeout=CONNECT_S,
                set_as_default=False,
            )
        except (OSError, ValueError, TypeError, ssl.SSLError) as error:
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise InputError(
                _WHERE,
                Unquoted(f"{address}: {reason}"),
                "the address of a running dask scheduler, and its certificates",
            ) from None
        with client:
            yield client


def _served(
    client: Client, address: str, timeout_s: float, tell: Callable[[str], None]
) -> Iterator[Cluster]:
    cluster = Cluster(client, address, timeout_s=timeout_s, tell=tell)
    try:
        cluster.begin()
        yield cluster
    finally:
        cluster.end()


# ---------- the same program everywhere


@cache
def program() -> str:
    """Version of this program and of Python, and a hash of code, data and libraries."""
    code = hash_of_code((*ALL_PACKAGES, "experiments"))
    return (
        f"place-rsus {version('place-rsus')} (code {code[:12]},"
        f" Python {python_version()})"
    )


def _other_program(where: str, theirs: str, expected: str) -> InputError:
    got = Unquoted(f"{where} with {theirs}")
    return InputError(_WHERE, got, f"scheduler and workers with {expected}")


class SameProgram(WorkerPlugin):  # type: ignore[misc]
    """Lets no worker join that has another program."""

    def __init__(self, expected: str) -> None:
        self.expected = expected

    def setup(self, worker: Worker) -> None:
        """Close a worker that has another program, before it gets a task."""
        if program() != self.expected:
            refused = str(_other_program(worker.address, program(), self.expected))
            worker.log_event(_PLUGIN, refused)
            worker.loop.add_callback(worker.close, reason=refused)


def _call(sent: bytes, *shared: Any) -> tuple[str, bool, Any]:
    """On a worker: its program, if the task was answered, and the answer or why not."""
    function, task = pickle.loads(sent)
    try:
        return program(), True, function(*shared, task)
    except InputError as error:  # nobody else will answer it either
        return program(), False, error
