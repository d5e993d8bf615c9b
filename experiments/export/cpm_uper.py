"""Collective perception messages as the bytes that are sent: unaligned packed encoding (UPER)."""

from typing import Any

from geometry.scene import Scene
from placement.layout import Layout

from .cpm import RELEASES, build_stations
from .formats import ExportFormat
from .uper import from_bytes, tell_load, to_bytes, to_records
from .watched import WatchedRun

_MESSAGE = "CollectivePerceptionMessage"
CONTAINERS = {
    2: "OriginatingRsuContainer", 3: "SensorInformationContainer", 5: "PerceivedObjectContainer"
}  # fmt: skip


def encode(message: dict[str, Any], release: str = RELEASES[0]) -> bytes:
    """Bytes of a message of :func:`.cpm.build_stations`, unsigned, without headers of the net."""
    payload = message["payload"]
    containers = []
    for container in payload["cpmContainers"]:
        data = to_bytes(CONTAINERS[container["containerId"]], container["containerData"], release)
        containers.append(container | {"containerData": data.hex()})
    whole = message | {"payload": payload | {"cpmContainers": containers}}
    return to_bytes(_MESSAGE, whole, release)


def decode(content: bytes, release: str = RELEASES[0]) -> dict[str, Any]:
    """Message of bytes, the inverse of :func:`encode`."""
    message: dict[str, Any] = from_bytes(_MESSAGE, content, release)
    for container in message["payload"]["cpmContainers"]:
        data = bytes.fromhex(container["containerData"])
        container["containerData"] = from_bytes(CONTAINERS[container["containerId"]], data, release)
    return message


def to_cpm_uper(
    layout: Layout, scene: Scene, watched: WatchedRun | None = None, *, release: str = RELEASES[0]
) -> bytes:
    """Layout's messages by time, as records: see :func:`.uper.to_records`.

    A message says which station it is from. Raises InputError as :func:`.cpm.build_stations`,
    MissingExtraError if asn1tools is not installed.
    """
    return to_records(
        (message["payload"]["managementContainer"]["referenceTime"], encode(message, release))
        for station in build_stations(layout, scene, watched, release=release)
        for message in station.messages
    )


FORMAT = ExportFormat(
    write=to_cpm_uper,
    content="the same messages as bytes (UPER); extra: v2x",
    is_binary=True,
    shows_runs=True,
    options=("release",),
    told=tell_load,
)
