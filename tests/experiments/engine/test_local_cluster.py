"""A scheduler of this machine, for one call: who can reach it, and what it limits.

Each starts processes that load dask, for seconds of processor time: all are long.
"""

import socket
import ssl
import subprocess
import sys

import pytest

pytest.importorskip("distributed")

import engine_tasks as tasks

from experiments.engine.start import EngineWish, start_engine

pytestmark = [
    pytest.mark.long,
    pytest.mark.filterwarnings("ignore"),  # those of dask
]


@pytest.fixture(scope="module")
def local():
    """An engine of two workers with a limit of memory."""
    wish = EngineWish(workers=2, scheduler="local", max_bytes=400 * 2**20)
    with start_engine(wish, n_tasks=4, tell=print) as started:
        yield started


def test_a_local_scheduler_answers_the_same_and_limits_memory(local):
    assert tasks.answers_of(local, tasks.square, range(6)) == {
        number: number * number for number in range(6)
    }

    sizes = [1_000_000, 600 * 2**20]
    found = tasks.answers_of(
        local, tasks.take, sizes, failed=lambda task, error: str(error)
    )
    assert found == {1_000_000: 1_000_000, 600 * 2**20: "more memory than it may take"}


ATTACK = """
import sys
from pathlib import Path
import distributed

port, mark = sys.argv[1:]
distributed.client.logger.disabled = True
tried = {
    "without credentials": (f"tcp://127.0.0.1:{port}", None),
    "with credentials of its own": (
        f"tls://127.0.0.1:{port}", distributed.Security.temporary()
    ),
}
for name, (address, security) in tried.items():
    try:
        client = distributed.Client(address, security=security, timeout=3)
        client.submit(Path(mark).touch).result(timeout=3)
        print(name, "ran something:", client.scheduler_info())
    except Exception as error:
        print(name, "got", type(error).__name__)
"""


def listening(process):
    import psutil

    for one in (process, *process.children(recursive=True)):
        for connection in one.net_connections():
            if connection.status == psutil.CONN_LISTEN:
                yield connection.laddr


def heard_by_tls(address, port):
    """What a client hears that takes any certificate, and has none."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    try:
        with (
            socket.create_connection((address, port), timeout=5.0) as talk,
            context.wrap_socket(talk) as wrapped,
        ):
            return wrapped.recv(1)
    except (ssl.SSLError, ConnectionError):
        return b""


def test_strangers_on_this_machine_get_nothing_and_run_nothing(local, tmp_path):
    import psutil

    tasks.answers_of(local, tasks.square, range(4))  # all is up
    found = list(listening(psutil.Process()))

    assert len(found) >= 4  # a scheduler, and workers

    mark = tmp_path / "mark"
    n_silent = 0
    for address, port in found:
        assert address == "127.0.0.1"

        with socket.create_connection((address, port), timeout=5.0) as talk:
            talk.sendall(b"GET /info/main/workers.html HTTP/1.1\r\nHost: x\r\n\r\n")
            try:
                answer = talk.recv(4096)
            except ConnectionResetError:
                answer = b""
        # HTTP servers, which dask starts in any case, know no address.
        assert not answer or answer.startswith((b"HTTP/1.1 404", b"\x15\x03"))

        if answer.startswith(b"HTTP"):
            continue
        n_silent += 1
        assert not heard_by_tls(address, port)

    assert n_silent >= 3  # a scheduler and two workers

    attacked = local._client.scheduler.address.rpartition(":")[2]
    done = subprocess.run(
        [sys.executable, "-c", ATTACK, attacked, str(mark)],
        capture_output=True,
        text=True,
        timeout=60,
    )

    assert done.returncode == 0, done.stderr
    assert [line.split(" got ")[0] for line in done.stdout.splitlines()] == [
        "without credentials",
        "with credentials of its own",
    ]
    assert not mark.exists()
    assert tasks.answers_of(local, tasks.square, [2]) == {2: 4}
