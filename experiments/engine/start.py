"""Which engine runs tasks: what the command line says, and what is there."""

import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from geometry.errors import InputError, MissingExtraError, Unquoted
from geometry.opening import read_bytes

from ..progress import no_tracker_warnings
from .processes import Processes
from .tasks import LEAST_BYTES, Engine, Here

LOCAL = "local"
"""In place of an address: a dask scheduler of this machine, started for the call."""

_WHERE = "--scheduler"
_MAX_BYTES = 2**20
_SCHEMES = ("tls://", "tcp://")


@dataclass(frozen=True, slots=True, kw_only=True)
class EngineWish:
    """Where tasks are to run.

    Attributes
    ----------
    workers : int
        Most processes on this machine; 1: the tasks run in this one.
    max_bytes : int, optional
        Memory of each of these processes; None: no limit.
    scheduler : str
        Address of a dask scheduler, its file, or "local"; empty: processes of this
        machine, without dask.
    tls_ca, tls_cert, tls_key : Path, optional
        Files in PEM: who is believed, who we are, and our private key.
    scheduler_timeout : float
        How long a scheduler may be without workers. [s]
    insecure_scheduler : bool
        A scheduler without TLS is taken, too.
    """

    workers: int = 1
    max_bytes: int | None = None
    scheduler: str = ""
    tls_ca: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None
    scheduler_timeout: float = 60.0
    insecure_scheduler: bool = False

    def on_this_machine(self) -> "EngineWish":
        """Without a scheduler: for tasks that use a folder of this machine."""
        return EngineWish(workers=self.workers, max_bytes=self.max_bytes)

    def with_workers(self, n: int) -> "EngineWish":
        """With at most so many processes of this machine."""
        return replace(self, workers=max(min(self.workers, n), 1))


@contextmanager
def start_engine(
    wish: EngineWish, *, n_tasks: int, tell: Callable[[str], None]
) -> Iterator[Engine]:
    """Start what runs tasks; it ends with the block.

    Without a scheduler these are processes of this machine; this process itself where
    there is one worker, or one task. `tell` gets sentences about what takes time.

    Raises
    ------
    InputError
        The scheduler does not answer, or is not safe.
    MissingExtraError
        dask is not installed.
    """
    n_workers = min(wish.workers, n_tasks)
    if not wish.scheduler:
        if n_workers <= 1:
            yield Here()
            return
        with no_tracker_warnings():
            processes = Processes(n_workers, max_bytes=wish.max_bytes or math.inf)
            try:
                yield processes
            finally:
                processes.close()
        return
    address = _address_of(wish)
    try:
        from .cluster import connect, start_local
    except ImportError:
        raise MissingExtraError(
            "--scheduler needs dask: pip install place-rsus[cluster]"
        ) from None
    if address == LOCAL:
        with start_local(
            max(n_workers, 1),
            max_bytes=wish.max_bytes or 0,
            timeout_s=wish.scheduler_timeout,
            tell=tell,
        ) as local:
            yield local
        return
    with connect(
        address,
        ca=wish.tls_ca,
        certificate=wish.tls_cert,
        key=wish.tls_key,
        timeout_s=wish.scheduler_timeout,
        tell=tell,
    ) as cluster:
        yield cluster


def memory_bytes(text: str) -> int:
    """The memory of a worker, in bytes; InputError if that is no amount, or too little.

    >>> memory_bytes("1.5GiB")
    1610612736
    """
    # Such as 1.5GiB, or bytes.
    amount = r"(\d+\.?\d*|\.\d+) *(?:(?:([kmgt])(i?))?b)?"
    size = 0.0
    if found := re.fullmatch(amount, text.strip().lower(), re.ASCII):
        power = "kmgt".find(found[2] or "-") + 1
        size = float(found[1]) * (1024 if found[3] else 1000) ** power
    if not LEAST_BYTES <= size <= 2**60:
        raise InputError(
            "--worker-memory",
            text,
            f"an amount such as 1.5GiB, at least {LEAST_BYTES >> 20}MiB",
        )
    return int(size)


class _SchedulerFile(msgspec.Struct, frozen=True):
    """What dask writes about a scheduler, as far as it is needed."""

    address: str


def _address_of(wish: EngineWish) -> str:
    """Address of the scheduler, if it is safe to talk to; InputError if not."""
    named = wish.scheduler
    if named == LOCAL:
        return LOCAL
    if "://" not in named and (named.endswith(".json") or Path(named).is_file()):
        content = read_bytes(Path(named), max_bytes=_MAX_BYTES)
        try:
            address = msgspec.json.decode(content, type=_SchedulerFile).address
        except msgspec.MsgspecError:
            raise InputError(
                _WHERE,
                Unquoted(f"{named}, which is cut off or something else"),
                "the whole file that `dask scheduler --scheduler-file` writes",
            ) from None
    else:
        address = named
    if not address.startswith(_SCHEMES):
        expected = "an address such as tls://10.0.0.1:8786, a scheduler file, or local"
        raise InputError(_WHERE, named, expected)
    if not address.startswith("tls://") and not wish.insecure_scheduler:
        raise InputError(
            _WHERE,
            Unquoted(f"{address}, without TLS: whoever reaches it can run programs"),
            "tls://, or --insecure-scheduler as well",
        )
    for path in (wish.tls_ca, wish.tls_cert, wish.tls_key):
        # A file that cannot be read is named before dask starts.
        if path is not None:
            read_bytes(path, max_bytes=_MAX_BYTES)
    return address
