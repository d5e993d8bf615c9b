"""Files within .zip archives, and archives that mean harm."""

import stat
import zipfile

import pytest
from damage import damaged
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from geometry import archives
from geometry.archives import unpacked
from geometry.errors import InputError

SUFFIXES = (".geojson", ".shp", ".xml")


def pack(tmp_path, files, compression=zipfile.ZIP_DEFLATED):
    """An archive of files: names and contents."""
    path = tmp_path / "maps.zip"
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, data in files:
            archive.writestr(name, data)
    return path


def names_in(tmp_path):
    """Names of what is in the folder."""
    return sorted(path.name for path in tmp_path.iterdir())


def test_the_one_file_is_there_with_its_neighbours_and_then_gone(tmp_path):
    files = [
        ("a/b/roads.SHP", "shp"),
        ("a/b/roads.dbf", "dbf"),
        ("readme.txt", ""),
    ]
    path = pack(tmp_path, files)

    with unpacked(path, SUFFIXES) as member:
        assert member.read_text() == "shp"
        assert (member.parent / "roads.dbf").read_text() == "dbf"
        folder = member.parents[2]

    assert not folder.exists()
    assert names_in(tmp_path) == ["maps.zip"]


def test_what_describes_a_file_and_what_hides_does_not_count(tmp_path):
    files = [
        ("roofs.shp", "1"),
        ("roofs.shp.xml", "2"),
        ("__MACOSX/roofs.shp", "3"),
        (".x.shp", "4"),
    ]
    with unpacked(pack(tmp_path, files), SUFFIXES) as member:
        assert member.read_text() == "1"


def test_errors_within_name_the_archive(tmp_path):
    path = pack(tmp_path, [("a.geojson", "{}")])
    with pytest.raises(InputError) as caught, unpacked(path, SUFFIXES) as member:
        raise InputError(f"{member}: type", 1, "two")
    assert str(caught.value) == f"{path}/a.geojson: type: got 1; expected two"


@pytest.mark.long
@pytest.mark.parametrize(
    ("files", "message"),
    [
        ([("../a.shp", "")], "leads out"),
        ([("a/../../b.shp", "")], "leads out"),
        ([("/etc/a.shp", "")], "leads out"),
        ([("C:a.shp", "")], "leads out"),
        ([("a\\..\\b.shp", "")], "leads out"),
        ([("a.shp", ""), ("A.shp", "")], "twice"),
        ([("a.shp", ""), ("b.geojson", "")], "2 files that can be read"),
        ([("a.txt", "")], "0 files that can be read"),
        ([], "0 files"),
        ([("a.shp", b"\0" * 30_000_000)], "at most 200 times"),
        ([(f"{index}.txt", "") for index in range(10_001)], "10,001 members"),
        ([("a", "file"), ("a/b.shp", "")], "readable .zip"),
    ],
)
def test_archives_that_lead_astray_are_refused(tmp_path, files, message):
    path = pack(tmp_path, files)
    with pytest.raises(InputError, match=message), unpacked(path, SUFFIXES):
        pass
    assert names_in(tmp_path) == ["maps.zip"]


def test_links_are_refused(tmp_path):
    link = zipfile.ZipInfo("a.shp")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    path = pack(tmp_path, [(link, "/etc")])

    with pytest.raises(InputError, match="link"), unpacked(path, SUFFIXES):
        pass


def test_large_archives_are_refused_before_they_are_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(archives, "MAX_UNPACKED_BYTES", 1000)
    files = [
        ("a.shp", b"x" * 600),
        ("b.dbf", b"x" * 600),
    ]
    path = pack(tmp_path, files, zipfile.ZIP_STORED)

    with pytest.raises(InputError, match="at most 1,000"), unpacked(path, SUFFIXES):
        pass


def test_encrypted_files_are_refused(tmp_path):
    path = pack(tmp_path, [("a.shp", "text")])
    data = bytearray(path.read_bytes())

    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(signature) + offset] |= 1

    path.write_bytes(data)

    with pytest.raises(InputError, match="encrypted"), unpacked(path, SUFFIXES):
        pass


@pytest.mark.parametrize("data", [b"", b"PK", b"no archive at all"])
def test_what_is_no_archive_is_refused(tmp_path, data):
    path = tmp_path / "a.zip"
    path.write_bytes(data)

    with pytest.raises(InputError, match="zip"), unpacked(path, SUFFIXES):
        pass

    missing = tmp_path / "none.zip"
    with pytest.raises(InputError, match="readable"), unpacked(missing, SUFFIXES):
        pass


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_archives_are_opened_or_refused(tmp_path, data):
    path = pack(tmp_path, [("a/b.shp", "shape" * 50), ("a/b.dbf", "table" * 50)])
    sound = path.read_bytes()
    path.write_bytes(data.draw(damaged(sound)))

    try:
        with unpacked(path, SUFFIXES) as member:
            assert member.is_file()
    except InputError as error:
        assert "\n" not in str(error)  # noqa: PT017
