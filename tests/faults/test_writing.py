"""Killed, without room, without rights, two at once: what is on disk stays whole."""

import errno
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import writing_process
from writing_process import MARKER, NAMES, read_table, write_results, write_table

from experiments.results.folders import changed_files, check_result_folder
from geometry.errors import InputError
from geometry.writing import write_atomically

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked")
N_KILLS = 20


@pytest.fixture
def folder(tmp_path):
    """A folder with a table and with results."""
    write_table(tmp_path, 1)
    write_results(tmp_path, 1)
    return tmp_path


@pytest.fixture
def start(folder):
    """Begins to write: the writer's process id."""
    folders = os.pathsep.join(map(str, (ROOT, ROOT / "tests/support")))
    maker = subprocess.Popen(
        [
            sys.executable,
            str(ROOT / "tests/support/writing_process.py"),
            str(folder),
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": folders, "OMP_NUM_THREADS": "1"},
    )
    begun = []

    def begin():
        assert maker.stdin is not None
        assert maker.stdout is not None

        maker.stdin.write("\n")
        maker.stdin.flush()
        begun.append(int(maker.stdout.readline()))
        return begun[-1]

    yield begin
    for child in begun:
        with suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
    maker.communicate()


def assert_whole(folder):
    """The table and the results are whole, and of one writing each; returns the
    results'.
    """
    table = read_table(folder)
    assert table is not None
    assert len(set(table.packed.ravel().tolist())) == 1
    assert changed_files(folder / "latest") == {}

    texts = {(folder / "latest" / name).read_text() for name in NAMES}

    assert len(texts) == 1

    return texts.pop()


@pytest.mark.long
def test_a_writer_killed_at_any_moment_leaves_the_old_or_the_new(folder, start, caplog):
    rng = random.Random(1)
    seen = set()
    for _ in range(N_KILLS):
        writer = start()
        time.sleep(rng.uniform(0.0, 0.15))
        os.kill(writer, signal.SIGKILL)
        seen.add(assert_whole(folder))

    assert len(seen) > 1  # some were new
    assert caplog.messages == []

    check_result_folder(folder / "latest")
    # What the killed have left is hidden, and goes with the next run.
    left = [path for path in folder.iterdir() if path.name not in ("cache", "latest")]
    left += [path for path in (folder / "cache").iterdir() if path.name != "table.npz"]

    assert all(path.name.startswith(".") for path in left)

    for path in left:
        os.utime(path, (0, 0))
    write_table(folder, 2)
    write_results(folder, 2)

    assert not any(path.exists() for path in left)
    assert sorted(path.name for path in folder.iterdir()) == ["cache", "latest"]


@pytest.mark.long
def test_two_writers_at_once_leave_the_results_of_one(folder, start):
    writers = [start(), start()]
    end_s = time.monotonic() + 1.0
    while time.monotonic() < end_s:
        table = read_table(folder)
        assert table is not None
        assert len(set(table.packed.ravel().tolist())) == 1

    for writer in writers:
        with suppress(ProcessLookupError):
            os.kill(writer, signal.SIGKILL)
    time.sleep(0.1)

    assert assert_whole(folder) != "1\n" * 20_000


@contextmanager
def largest_file(n_bytes):
    """No file may become larger: for a program this looks like a disk that is full."""
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("n_bytes", [0, 100, 20_000, 39_000])
def test_without_room_the_old_stays_and_what_is_wrong_is_said(folder, n_bytes, caplog):
    with largest_file(n_bytes):
        write_table(folder, 2)
        with pytest.raises((InputError, OSError)) as caught:
            write_results(folder, 2)

    (message,) = caplog.messages

    assert message.startswith("detection table not cached: ")
    assert message.endswith(os.strerror(errno.EFBIG))
    assert assert_whole(folder) == "1\n" * 20_000
    assert sorted(path.name for path in folder.iterdir()) == ["cache", "latest"]
    # Of a summary that is cut off nobody has anything.
    assert "kept" not in str(caught.value)


def test_a_full_disk_is_said_and_the_old_stays(tmp_path, caplog):
    folder = tmp_path / "disk"
    folder.mkdir()
    options = ["-t", "tmpfs", "-o", "size=600k", "tmpfs", str(folder)]
    mount = shutil.which("mount")
    if (
        mount is None
        or subprocess.run([mount, *options], capture_output=True).returncode
    ):
        pytest.skip("no small disk can be made here")
    try:
        write_table(folder, 1)
        write_results(folder, 1)
        write_atomically(folder / "filler", lambda file: file.write(bytes(200_000)))
        write_table(folder, 2)
        with pytest.raises(InputError, match="No space left on device") as caught:
            write_results(folder, 2)

        kept = folder / "latest.unfinished"
        assert str(caught.value).endswith(f"what was computed is kept in {kept}")
        assert (kept / MARKER).read_text() == "2\n" * 20_000
        assert caplog.messages[0].endswith("No space left on device")
        assert assert_whole(folder) == "1\n" * 20_000
    finally:
        subprocess.run(["umount", str(folder)], check=True)


@contextmanager
def as_nobody():
    """Without root's right to write anywhere."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def test_a_folder_without_rights_is_refused_before_anything_is_computed(caplog):
    folder = Path(tempfile.mkdtemp(prefix="place-rsus-test-"))
    try:
        write_table(folder, 1)
        write_results(folder, 1)
        for path in (folder, folder / "cache"):
            path.chmod(0o555)
        with as_nobody():
            for out in (folder / "latest", folder / "new"):
                with pytest.raises(
                    InputError, match="Permission denied; expected a folder that"
                ):
                    check_result_folder(out)
            write_table(folder, 2)
            with pytest.raises(InputError, match="Permission denied"):
                write_results(folder, 2)

        assert caplog.messages[0].endswith("Permission denied")
        assert assert_whole(folder) == "1\n" * 20_000
    finally:
        folder.chmod(0o755)
        (folder / "cache").chmod(0o755)
        shutil.rmtree(folder)


def test_a_failure_while_files_are_put_in_place_leaves_the_old(folder, monkeypatch):
    def fail(first, second):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr("experiments.results.folders._exchange", fail)

    with pytest.raises(
        InputError, match=r"what was computed is kept in .*latest\.unfinished$"
    ):
        write_results(folder, 2)

    assert assert_whole(folder) == "1\n" * 20_000
    assert (folder / "latest.unfinished" / MARKER).read_text() == "2\n" * 20_000

    monkeypatch.undo()
    write_results(folder, 3)

    assert assert_whole(folder) == "3\n" * 20_000


def test_a_child_ends_by_itself(tmp_path):
    child = writing_process.in_a_child(lambda: (tmp_path / "a").touch())
    assert os.waitpid(child, 0)[1] == 0
    assert (tmp_path / "a").exists()
