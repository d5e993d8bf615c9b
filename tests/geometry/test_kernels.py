"""Machine code in the user's cache, by processes of their own: what is loaded stays
loaded.
"""

import json
import os
import shutil
import subprocess
import sys
from itertools import count
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
_PROGRAM = """
import logging
logging.basicConfig(format="%(message)s")
from numba.core import event
from geometry.kernels import kernel
import summing
with event.install_recorder("numba:compile") as compiling:
    print(summing.total(3.5, 4))
print(int(not compiling.buffer))
"""
_MODULE = """
from geometry.kernels import kernel

@kernel
def twice(x):
    return x + x

@kernel
def total(x, n):
    found = 0.0
    for _ in range(n):
        found += twice(x)
    return found / 0.0 if n < 0 else found
"""


# Loads the compiler once, and lets it find its feet; each program is forked from there.
_STARTER = """
import json, os, sys, traceback
import numba

@numba.njit(nogil=True, error_model="numpy")
def warm(x, n):
    return x / 0.0 if n < 0 else x

warm(1.0, 1)
for line in sys.stdin:
    asked = json.loads(line)
    if "ends" in asked:
        print(os.waitstatus_to_exitcode(os.waitpid(asked["ends"], 0)[1]), flush=True)
        continue
    child = os.fork()
    if child:
        print(child, flush=True)
        continue
    for number, path in enumerate(asked["files"], start=1):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), number)
    os.environ["NUMBA_CACHE_DIR"] = asked["cache"]
    sys.path[:0] = asked["modules"]
    code = 1
    try:
        exec(asked["program"], {"__name__": "__main__"})
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(code)
"""


@pytest.fixture(scope="module")
def starter():
    """A function that starts a process with the compiled kernels."""
    with subprocess.Popen(
        [sys.executable, "-c", _STARTER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:

        def ask(**asked):
            process.stdin.write(json.dumps(asked) + "\n")
            process.stdin.flush()
            return int(process.stdout.readline())

        yield ask
        process.stdin.close()


@pytest.fixture(scope="module")
def start(starter, tmp_path_factory):
    """Start a program that sums, by the modules of a folder, with another one as the
    cache.
    """
    place = tmp_path_factory.mktemp("program")
    (place / "summing.py").write_text(_MODULE)
    numbers = count()

    def build(folder, before="", modules=place):
        number = next(numbers)
        files = [place / f"{number}-{name}" for name in ("out", "err")]
        child = starter(
            program=before + _PROGRAM,
            cache=str(folder),
            modules=[str(ROOT), str(modules)],
            files=[str(path) for path in files],
        )
        return lambda: (starter(ends=child), *(path.read_text() for path in files))

    return build


@pytest.fixture(scope="module")
def compiled(start, tmp_path_factory):
    """What the first program leaves in its folder: to be copied."""
    folder = tmp_path_factory.mktemp("first") / "compiled"
    assert _end(start(folder)) == (0, COMPILING)
    return folder


def _end(wait):
    """What a process told, and with which code it ended."""
    code, out, err = wait()
    assert code == 0, err
    total, hits = out.split()
    assert total == "28.0"
    return int(hits), err.splitlines()


COMPILING = ["compiling for this machine, once: some seconds"]


@pytest.mark.long
def test_code_is_compiled_once_and_said_so_also_by_two_processes_at_once(
    start, tmp_path
):
    folder = tmp_path / "compiled"
    both = [start(folder), start(folder)]

    for wait in both:
        _, told = _end(wait)
        assert told in (COMPILING, [])
    assert _end(start(folder)) == (1, [])


@pytest.mark.long
@pytest.mark.parametrize(
    ("place", "harm"),
    [
        (0.5, "cut"),
        (0.0, "cut"),
        (0.0001, "cut"),
        (0.01, "flipped"),
        (0.5, "flipped"),
        (0.99, "flipped"),
    ],
)
def test_damaged_code_is_compiled_anew(start, compiled, tmp_path, place, harm):
    folder = Path(shutil.copytree(compiled, tmp_path / "compiled"))
    (file,) = folder.glob("*.kernel")
    data = bytearray(file.read_bytes())
    at = int(place * len(data))
    data[at] ^= 16
    file.write_bytes({"cut": data[:at], "flipped": data}[harm])
    hits, told = _end(start(folder))

    assert hits == 0
    assert len(told) == 2
    assert told[0].startswith("cached machine code not used, made anew: ")
    assert told[1:] == COMPILING
    assert _end(start(folder)) == (1, [])


@pytest.mark.long
def test_code_is_compiled_anew_when_kernels_beside_it_change(start, tmp_path):
    twice, total = _MODULE.split("@kernel\ndef total")
    (tmp_path / "doubling_kernels.py").write_text(twice)
    (tmp_path / "summing.py").write_text(
        "from geometry.kernels import kernel\nfrom doubling_kernels import twice\n\n"
        f"@kernel\ndef total{total}"
    )

    assert [_end(start(tmp_path / "cache", modules=tmp_path))[0] for _ in range(2)] == [
        0,
        1,
    ]

    (tmp_path / "doubling_kernels.py").write_text(twice.replace("x + x", "2.0 * x"))
    assert [_end(start(tmp_path / "cache", modules=tmp_path))[0] for _ in range(2)] == [
        0,
        1,
    ]


@pytest.mark.long
def test_where_no_folder_can_be_made_a_private_temporary_one_has_the_code(
    start, tmp_path
):
    (tmp_path / "file").touch()
    folder = tmp_path / "file" / "below"
    temporary = f"import tempfile; tempfile.tempdir = {str(tmp_path)!r}\n"
    instead = tmp_path / f"place-rsus-{os.getuid()}"
    told = (
        f"compiled code is cached in {instead}: {folder} cannot be made (Not a"
        " directory)"
    )

    assert _end(start(folder, before=temporary)) == (0, [told, *COMPILING])
    assert _end(start(folder, before=temporary)) == (1, [told])


def test_code_of_a_folder_into_which_others_may_write_is_not_run(
    start, compiled, tmp_path
):
    folder = Path(shutil.copytree(compiled, tmp_path / "compiled"))
    temporary = f"import tempfile; tempfile.tempdir = {str(tmp_path)!r}\n"
    instead = tmp_path / f"place-rsus-{os.getuid()}"
    folder.chmod(0o777)
    told = (
        f"compiled code is cached in {instead}: {folder} can be written to by other"
        " users"
    )

    assert _end(start(folder, before=temporary)) == (0, [told, *COMPILING])

    folder.chmod(0o700)
    assert _end(start(folder)) == (1, [])


@pytest.mark.long
def test_code_that_others_may_write_is_not_run(start, compiled, tmp_path):
    folder = Path(shutil.copytree(compiled, tmp_path / "compiled"))
    (file,) = folder.glob("*.kernel")
    file.chmod(0o666)
    hits, told = _end(start(folder))

    assert hits == 0
    assert len(told) == 2
    assert "another user may have written it" in told[0]
    assert _end(start(folder)) == (1, [])


@pytest.mark.long
@pytest.mark.skipif(
    not hasattr(os, "getuid") or os.getuid() != 0, reason="only root gives away"
)
def test_code_of_another_user_is_not_run(start, compiled, tmp_path):
    folder = Path(shutil.copytree(compiled, tmp_path / "compiled"))
    (file,) = folder.glob("*.kernel")
    os.chown(file, 4321, 4321)
    hits, told = _end(start(folder))

    assert hits == 0
    assert len(told) == 2
    assert "another user may have written it" in told[0]
    assert _end(start(folder)) == (1, [])


@pytest.mark.long
def test_a_full_disk_costs_no_more_than_time(start, tmp_path):
    folder = tmp_path / "compiled"
    fill = """
import errno, geometry.kernels
def full(*args, **options):
    raise OSError(errno.ENOSPC, "No space left on device")
geometry.kernels.write_atomically = full
"""
    hits, told = _end(start(folder, before=fill))

    assert hits == 0
    assert told == [
        *COMPILING,
        f"machine code not cached: {folder}: No space left on device",
    ]


@pytest.mark.long
def test_a_folder_that_goes_while_the_program_runs_costs_no_more_than_time(
    start, tmp_path
):
    folder = tmp_path / "compiled"
    gone = f"""
import shutil, geometry.kernels, summing
geometry.kernels.compiled_folder()
shutil.rmtree({str(folder)!r})
open({str(folder)!r}, "w").close()
"""
    hits, told = _end(start(folder, before=gone))

    assert hits == 0
    assert told[0].startswith(f"machine code not cached: {folder}: ")
    assert told[1:] == COMPILING


@pytest.mark.long
def test_numba_that_cannot_write_what_it_compiled_costs_no_more_than_time(
    start, tmp_path
):
    folder = tmp_path / "compiled"
    lose = """
import shutil, geometry.kernels
build = geometry.kernels._OnDisk._build
def build_and_lose(self):
    compiled = build(self)
    shutil.rmtree(self._folder)
    self._folder.symlink_to("nowhere")
    return compiled
geometry.kernels._OnDisk._build = build_and_lose
"""
    hits, told = _end(start(folder, before=lose))

    assert hits == 0
    assert told[0] == COMPILING[0]
    assert told[1].startswith(f"machine code not cached: {folder}: ")
    assert _end(start(folder)) == (0, COMPILING)


def test_only_kernels_stay_in_the_folder_when_the_program_ends(start, tmp_path):
    folder = tmp_path / "compiled"
    ends = "import atexit, summing; summing.total(3.5, 4); atexit._run_exitfuncs()\n"

    assert _end(start(folder, before=ends)) == (1, COMPILING)
    assert [path.suffix for path in folder.iterdir()] == [".kernel"]


@pytest.mark.long
def test_folders_of_programs_that_were_killed_are_removed(start, compiled, tmp_path):
    folder = Path(shutil.copytree(compiled, tmp_path / "compiled"))
    left = folder / "running-killed"
    young = folder / "running-young"

    for one in (left, young):
        (one / "within").mkdir(parents=True)
    os.utime(left, (1.0, 1.0))

    assert _end(start(folder)) == (1, [])
    assert not left.exists()
    assert young.exists()


# Quickly: nothing; two kernels are compiled in a process of their own.
@pytest.mark.long
def test_literal_numbers_in_calls_of_kernels_make_no_versions_of_their_own(
    start, tmp_path
):
    (tmp_path / "adding.py").write_text(
        """
from geometry.kernels import kernel

@kernel
def add(x, n):
    return x + n

@kernel
def total(x, n):
    return add(x, 1) + add(x, 2) + add(x, n)
"""
    )
    count = """
import sys
from numba.core import event
import adding
with event.install_recorder("numba:compile") as compiling:
    assert adding.total(1.0, 5) == 11.0
starts = [found for _, found in compiling.buffer if found.is_start]
names = [found.data["dispatcher"].__name__ for found in starts]
print(sorted(names), file=sys.stderr)
"""
    before = f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n" + count
    _, told = _end(start(tmp_path / "compiled", before=before))

    assert "['add', 'total']" in told
