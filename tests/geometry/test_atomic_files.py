"""Files that are there as a whole or not at all."""

import os
import stat

import pytest

from geometry.writing import write_atomically


def _names(folder):
    """Names of what is in a folder."""
    return sorted(path.name for path in folder.iterdir())


def test_a_file_is_written_and_nothing_else_is_left(tmp_path):
    path = tmp_path / "a.bin"
    write_atomically(path, lambda file: file.write(b"\x00new"))

    assert path.read_bytes() == b"\x00new"
    assert _names(tmp_path) == ["a.bin"]


def test_a_file_that_is_there_is_replaced(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"a long old content")
    write_atomically(path, lambda file: file.write(b"new"))

    assert path.read_bytes() == b"new"


def test_the_old_file_stays_until_the_new_one_is_whole(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")

    def write(file):
        file.write(b"new")
        file.flush()
        assert path.read_bytes() == b"old"
        (temporary,) = (other for other in tmp_path.iterdir() if other != path)
        assert temporary.name.startswith(".a.bin.")
        assert temporary.suffix == ".tmp"

    write_atomically(path, write)
    assert path.read_bytes() == b"new"


@pytest.mark.parametrize("error", [ValueError, OSError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("is_there", [True, False])
def test_whatever_is_raised_leaves_everything_as_it_was(tmp_path, error, is_there):
    path = tmp_path / "a.bin"
    if is_there:
        path.write_bytes(b"old")

    def write(file):
        file.write(b"half")
        raise error("stop")

    with pytest.raises(error, match="stop"):
        write_atomically(path, write)
    assert _names(tmp_path) == (["a.bin"] if is_there else [])
    assert not is_there or path.read_bytes() == b"old"


def test_a_folder_in_the_way_is_an_error_and_stays(tmp_path):
    path = tmp_path / "a.bin"
    path.mkdir()

    with pytest.raises(OSError, match=r"a\.bin"):
        write_atomically(path, lambda file: file.write(b"new"))
    assert _names(tmp_path) == ["a.bin"]


def test_a_missing_folder_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_atomically(tmp_path / "no" / "a.bin", lambda file: None)


@pytest.mark.parametrize(
    ("mask", "mode"),
    [
        (0o022, 0o644),
        (0o077, 0o600),
        (0o002, 0o664),
    ],
)
def test_a_file_is_as_readable_as_any_other_new_one(tmp_path, mask, mode):
    before = os.umask(mask)
    try:
        write_atomically(tmp_path / "a.bin", lambda file: file.write(b"new"))
        (tmp_path / "b.bin").touch()
        found = [
            stat.S_IMODE((tmp_path / name).stat().st_mode)
            for name in ("a.bin", "b.bin")
        ]
        assert os.umask(mask) == mask
    finally:
        os.umask(before)

    assert found == [mode, mode]

    write_atomically(
        tmp_path / "c.bin", lambda file: file.write(b"new"), is_private=True
    )
    assert stat.S_IMODE((tmp_path / "c.bin").stat().st_mode) == 0o600
