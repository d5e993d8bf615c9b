"""The scheduler of a dask cluster, for jobs whose tasks run on its workers."""

from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from typing import Any

from geometry.errors import InputError, Unquoted
from placement.cache import ALL_PACKAGES, hash_of_files

ANSWER_S = 10.0
"""A scheduler and its workers answer within so many seconds."""


def connect_to_scheduler(address: str) -> Any:
    """A client of a scheduler whose workers have this program, by a hash of its code and data.

    Raises
    ------
    ImportError
        dask is not installed.
    InputError
        No scheduler answers, it has no workers, or one of these has another program.
    """
    from distributed import Client

    try:
        client = Client(address, timeout=ANSWER_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            "--scheduler",
            Unquoted(f"{address}: {reason}"),
            "the address of a running dask scheduler, such as tls://10.0.0.1:8786",
        ) from None
    try:
        _check_workers(client, address)
    except BaseException:
        client.close()
        raise
    return client


def _check_workers(client: Any, address: str) -> None:
    from distributed import TimeoutError as DaskTimeoutError

    try:
        client.wait_for_workers(1, timeout=ANSWER_S)
    except DaskTimeoutError:
        raise InputError(
            "--scheduler", Unquoted(f"{address} without workers"), "a scheduler with workers"
        ) from None
    try:
        programs = client.run(program)
    except Exception as error:  # whatever their Python says
        raise InputError(
            "--scheduler",
            Unquoted(f"{address}: {type(error).__name__} on a worker: {str(error)[:120]}"),
            "workers with this version of place-rsus",
        ) from None
    for worker, theirs in programs.items():
        _refuse_other(theirs, f"{address}: {worker}")


@cache
def program() -> str:
    """Version of this program, and a hash of its code and data."""
    hashes = [hash_of_files(package).hex()[:8] for package in (*ALL_PACKAGES, "experiments")]
    return f"place-rsus {version('place-rsus')} ({'-'.join(hashes)})"


def run_alike(asked: str, function: Callable[[Any], Any], task: Any) -> Any:
    """On a worker: what a function says of a task, if the program is the one that asks.

    Workers may join while others work already.
    """
    _refuse_other(asked, "a worker that joined later")
    return function(task)


def _refuse_other(theirs: str, where: str) -> None:
    if theirs != program():
        raise InputError(
            "--scheduler",
            Unquoted(f"{where} with {theirs}"),
            f"workers with the same code, {program()}",
        )
