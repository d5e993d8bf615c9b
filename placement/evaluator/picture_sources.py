"""Registry of picture sources: what draws the frames of runs as cameras see them."""

import io
from collections.abc import Callable, Sequence
from typing import Protocol

from geometry.arrays import FloatArray
from geometry.registry import pick_entry
from geometry.scene import Scene
from scenarios.runs import Run

from ..detectors.evidence import Crops, Image
from .surroundings import FrameCamera

RENDERED = "rendered"
PICTURE_SOURCES = {RENDERED: "placement.evaluator.pictures:RenderedPictures"}
"""Picture sources by name; each entry makes a :class:`PictureSource`."""
_JPEG_QUALITY = 85

PictureOfFrame = Callable[[int], Image]
"""From the number of a frame of all runs, end to end, to its image (h, w, 3)."""


class PictureSource(Protocol):
    """What draws the frames of runs when they are asked for, from several threads."""

    @property
    def n_drawn(self) -> int:
        """Pictures and crops so far."""

    def pictures(self, camera: FrameCamera) -> PictureOfFrame:
        """Function from a frame of all runs, end to end, to a camera's image."""

    def crops(self, camera: FrameCamera, boxes_px: FloatArray) -> Crops:
        """Crops of a camera's pictures around the road user's boxes (n, 4)."""

    def close(self) -> None:
        """Draw no more: whoever asks for another picture is stopped."""


class PictureSourceEntry(Protocol):
    """An entry of ``PICTURE_SOURCES``."""

    def __call__(
        self, scene: Scene, runs: Sequence[Run], *, seed: int, workers: int = 1
    ) -> PictureSource:
        """Picture source of the frames of some runs.

        `seed` is that of sensor noise; `workers` are the threads of each picture.
        """


def build_picture_source(
    scene: Scene,
    runs: Sequence[Run],
    *,
    seed: int,
    workers: int = 1,
    name: str = RENDERED,
) -> PictureSource:
    """Picture source of a name. Raises InputError: there is none of that name."""
    entry: PictureSourceEntry = pick_entry(PICTURE_SOURCES, name, where="pictures")
    return entry(scene, runs, seed=seed, workers=workers)


def to_jpeg(rgb: Image) -> bytes:
    """An image (h, w, 3) as the bytes of a JPEG file."""
    from PIL import Image as PilImage

    buffer = io.BytesIO()
    PilImage.fromarray(rgb).save(buffer, format="jpeg", quality=_JPEG_QUALITY)
    return buffer.getvalue()
