"""VRU awareness messages as the bytes that are sent: unaligned packed encoding (UPER)."""

from geometry.scene import Scene
from scenarios.runs import Run

from .cpm import RELEASES
from .formats import ExportFormat
from .uper import tell_load, to_bytes, to_records
from .vam import build_messages


def to_vam_uper(
    run: Run, scene: Scene, *, vam_rate: float | None = None, release: str = RELEASES[0]
) -> bytes:
    """Messages of :func:`.vam.build_messages` as records: see :func:`.uper.to_records`.

    Raises MissingExtraError if asn1tools is not installed.
    """
    messages = build_messages(run, scene, vam_rate=vam_rate, release=release)
    return to_records((time_ms, to_bytes("VAM", one, release)) for time_ms, one in messages)


FORMAT = ExportFormat(
    write=to_vam_uper,
    content="the same messages as bytes (UPER); extra: v2x",
    is_binary=True,
    drives_run=True,
    has_units=False,
    options=("release", "vam_rate"),
    told=tell_load,
)
