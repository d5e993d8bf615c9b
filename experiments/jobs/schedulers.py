"""The scheduler of a dask cluster, for jobs whose tasks run on its workers."""

from typing import Any

from geometry.errors import InputError, Unquoted

ANSWER_S = 10.0
"""A scheduler and its workers answer within so many seconds."""


def connect_to_scheduler(address: str) -> Any:
    """A client of a scheduler; InputError if none answers. Raises ImportError without dask."""
    from distributed import Client

    try:
        return Client(address, timeout=ANSWER_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            "--scheduler",
            Unquoted(f"{address}: {reason}"),
            "the address of a running dask scheduler, such as tcp://10.0.0.1:8786",
        ) from None
