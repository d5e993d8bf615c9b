"""A dask cluster of processes at 127.0.0.1, and certificates for it."""

import datetime
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

STARTS_S = 60.0  # on a busy machine


def write_certificates(folder: Path, name: str) -> tuple[Path, Path]:
    """Files of an authority, and of a certificate with its key that it signed."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import NameOID

    def subject(of: str) -> x509.Name:
        return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, of)])

    now = datetime.datetime.now(datetime.UTC)
    authority_key = ec.generate_private_key(ec.SECP256R1())
    own_key = ec.generate_private_key(ec.SECP256R1())
    files = []
    for of, key, is_authority in (
        (f"{name}-ca", authority_key, True),
        (name, own_key, False),
    ):
        certificate = (
            x509.CertificateBuilder()
            .subject_name(subject(of))
            .issuer_name(subject(f"{name}-ca"))
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - datetime.timedelta(days=1))
            .not_valid_after(now + datetime.timedelta(days=1))
            .add_extension(x509.BasicConstraints(is_authority, None), critical=True)
            .sign(authority_key, hashes.SHA256())
        )
        content = certificate.public_bytes(serialization.Encoding.PEM)
        if not is_authority:
            content += key.private_bytes(
                serialization.Encoding.PEM,
                serialization.PrivateFormat.PKCS8,
                serialization.NoEncryption(),
            )
        path = folder / f"{of}.pem"
        path.write_bytes(content)
        files.append(path)
    authority, own = files
    return authority, own


@dataclass
class DaskProcesses:
    """A scheduler and workers; `file` is the scheduler's, `options` reach it."""

    folder: Path
    tls: tuple[str, ...]
    options: tuple[object, ...]
    file: Path
    scheduler: "subprocess.Popen[bytes] | None" = None
    workers: "list[subprocess.Popen[bytes]]" = field(default_factory=list)

    def start(self, role: str, *more: object) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", f"distributed.cli.dask_{role}"]
        command += ["--scheduler-file", str(self.file), "--host", "tls://127.0.0.1"]
        command += [*self.tls, "--no-dashboard", *map(str, more)]
        path = os.pathsep.join(filter(None, sys.path))
        return subprocess.Popen(
            command,
            env=os.environ | {"PYTHONPATH": path},
            stdout=subprocess.DEVNULL,
            stderr=(self.folder / f"{role}.log").open("ab"),
        )

    def start_worker(self, *more: object) -> None:
        """A worker that its nanny starts again when it has died."""
        folder = self.folder / "scratch"
        settings = ("--nthreads", 1, "--local-directory", folder)
        self.workers.append(self.start("worker", *settings, *more))

    def address(self) -> str:
        return json.loads(self.file.read_text())["address"]

    def stop_workers(self) -> None:
        """End them, with what their nannies started."""
        while self.workers:
            _end(self.workers.pop())

    def stop(self) -> None:
        self.stop_workers()
        if self.scheduler is not None:
            _end(self.scheduler)

    def kill_a_worker(self, index: int) -> None:
        """Kill the process that runs tasks; its nanny starts another one."""
        import psutil

        # Beside it, there may be the tracker of resources.
        for child in psutil.Process(self.workers[index].pid).children():
            if "resource_tracker" not in " ".join(child.cmdline()):
                child.send_signal(signal.SIGKILL)


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End a process and its children."""
    import psutil

    if process.poll() is None:
        children = psutil.Process(process.pid).children(recursive=True)
        process.kill()  # first, so that it starts no other one
        for child in children:
            child.kill()
    process.wait()


@contextmanager
def dask_processes(
    folder: Path, *, n: int, more: tuple = (), of_scheduler: tuple = ()
) -> Iterator[DaskProcesses]:
    """A scheduler with `n` workers behind TLS, at 127.0.0.1."""
    authority, own = write_certificates(folder, "mine")
    tls = ("--tls-ca-file", str(authority), "--tls-cert", str(own))
    tls += ("--tls-key", str(own))
    file = folder / "scheduler.json"
    options = ("--scheduler", file, "--tls-ca", authority, "--tls-cert", own)
    cluster = DaskProcesses(
        folder=folder,
        tls=tls,
        options=options,
        file=file,
    )
    try:
        cluster.scheduler = cluster.start(
            "scheduler", "--port", 0, "--protocol", "tls", *of_scheduler
        )
        until_s = time.monotonic() + STARTS_S
        while not (file.exists() and file.stat().st_size):
            assert cluster.scheduler.poll() is None, (
                folder / "scheduler.log"
            ).read_text()
            assert time.monotonic() < until_s
            time.sleep(0.05)
        for _ in range(n):
            cluster.start_worker(*more)
        yield cluster
    finally:
        cluster.stop()
