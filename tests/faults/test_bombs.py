"""Small files that unpack to much, or claim it: refused in 10 s of processor time and 1
GiB.
"""

import io
import json
import struct
import sys
import zipfile

import numpy as np
import pytest
from limited_reading import Process

from geometry.scene_files import THINGS_FILE
from geometry.scene_sources import SCENE_FILE

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="limits of memory are Linux's"
)
# Beside it the rest looks honest: 1 to 180.
NOISE = np.random.default_rng(1).bytes(600_000)


@pytest.fixture(scope="module")
def process():
    one = Process()
    yield one
    one.end()


def zeros(n_bytes, head=b""):
    """A member of an archive, written without ever being in memory."""

    def write(archive, name):
        with archive.open(name, "w", force_zip64=True) as member:
            member.write(head)
            for _ in range(n_bytes >> 20):
                member.write(bytes(1 << 20))

    return write


def pack(path, members):
    """Archive of some members."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, content in members.items():
            if isinstance(content, bytes):
                archive.writestr(name, content)
            else:
                content(archive, name)

    return path


def glb(n_bytes):
    """The head of a mesh file with so many bytes of data."""
    text = json.dumps(
        {"asset": {"version": "2.0"}, "buffers": [{"byteLength": n_bytes}]}
    ).encode()
    text += b" " * (-len(text) % 4)
    whole = 12 + 8 + len(text) + 8 + n_bytes
    head = (
        struct.pack("<4sII", b"glTF", 2, whole)
        + struct.pack("<I4s", len(text), b"JSON")
        + text
    )
    return head + struct.pack("<I4s", n_bytes, b"BIN\0")


def scene_of_toml(path):
    """An archive whose table unpacks to 22 MB."""
    table = b"a = 1\n" + b"# a line of a comment\n" * 1_000_000  # 22 MB
    return pack(path, {SCENE_FILE: table, THINGS_FILE: b"glTF", "noise": NOISE})


def scene_of_mesh(path):
    """An archive whose mesh unpacks to 301 MiB."""
    n_bytes = 301 << 20
    mesh = zeros(n_bytes, glb(n_bytes))
    return pack(path, {SCENE_FILE: b"a = 1", THINGS_FILE: mesh, "noise": NOISE * 3})


def instance(path):
    """An array of 2 GB, as its archive says; none of it is there."""
    kind = io.BytesIO()
    np.save(kind, np.array("place-rsus/placement-problem/1"))
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("kind.npy", kind.getvalue())
        archive.writestr("packed.npy", b"")
        archive.filelist[-1].file_size = 2100 << 20

    return path


def shifted_roofs(path):
    """Roofs 6 km high: what a height in another unit, or a damaged scale, makes of a
    house.
    """
    import laspy

    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = [0.01] * 3
    header.offsets = [390_000.0, 5_819_000.0, 35.0]
    las = laspy.LasData(header)
    x, y = (
        axis.ravel() for axis in np.meshgrid(0.25 * np.arange(60), 0.25 * np.arange(60))
    )
    roof = np.column_stack([x, y, np.full(len(x), 6000.0)])
    ground = np.column_stack([x * 2.0 - 8.0, y * 2.0 - 8.0, np.zeros(len(x))])
    las.x, las.y, las.z = (np.concatenate([roof, ground]) + header.offsets).T
    las.classification = np.repeat([6, 2], len(x)).astype(np.uint8)
    las.write(path)
    return path


@pytest.mark.long
@pytest.mark.parametrize(
    ("make", "name", "reader", "message"),
    [
        (scene_of_toml, "a.zip", "scenes", "more than 20,000,000 bytes"),
        (scene_of_mesh, "a.zip", "scenes", "more than 300,000,000 bytes"),
        (
            instance,
            "a.npz",
            "placement problems",
            "the budget of everything that is packed",
        ),
        (shifted_roofs, "a.laz", "things", "walls of 86,403,600 voxels"),
    ],
)
def test_what_unpacks_to_gigabytes_is_refused(
    process, tmp_path, make, name, reader, message
):
    path = make(tmp_path / name)
    assert path.stat().st_size < 8_000_000

    answer = process.ask(reader, path)

    assert answer["outcome"] == "refused", answer["text"]
    assert message in answer["text"]
