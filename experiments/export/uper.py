"""Messages of V2X stations as bytes (UPER), as records of a file.

And their load of a channel.
"""

import json
from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from typing import Any

from geometry.scene import Scene
from placement.layout import Layout

from . import ExportFormat, load_extra
from .cpm import RELEASES, build_stations
from .watched import WatchedRun

_MESSAGE = "CollectivePerceptionMessage"
CONTAINERS = {
    2: "OriginatingRsuContainer",
    3: "SensorInformationContainer",
    5: "PerceivedObjectContainer",
}
_TIME_BYTES = 8
_SIZE_BYTES = 4
# Bytes of a message: behind protocol version and message id.
_STATION = slice(2, 6)
# ITS-G5's default data rate: ETSI EN 302 663.
_CHANNEL_MBPS = 6.0


@cache
def _codecs(release: str) -> tuple[Any, Any]:
    """UPER's and JSON's rules of ``data/v2x.asn``, with the lines of a release."""
    asn1tools = load_extra("asn1tools", "messages as bytes need asn1tools", "v2x")
    others = tuple(f"-- {other}" for other in RELEASES if other != release)
    text = (files("experiments") / "data" / "v2x.asn").read_text(encoding="utf-8")
    lines = "\n".join(line for line in text.splitlines() if not line.endswith(others))
    return asn1tools.compile_string(lines, "uper"), asn1tools.compile_string(
        lines, "jer"
    )


def to_bytes(name: str, value: object, release: str) -> bytes:
    """Bytes of a value of a type of ``data/v2x.asn``, given as JSON writes it."""
    uper, jer = _codecs(release)
    content: bytes = uper.encode(name, jer.decode(name, json.dumps(value).encode()))
    return content


def from_bytes(name: str, content: bytes, release: str) -> Any:
    """Value of bytes, the inverse of :func:`to_bytes`."""
    uper, jer = _codecs(release)
    return json.loads(jer.encode(name, uper.decode(name, content)))


def to_records(messages: Iterable[tuple[int, bytes]]) -> bytes:
    """Times in milliseconds and bytes of messages as a file, by time.

    A record is the time (8 bytes), the size (4), both big-endian, and the message.
    """
    return b"".join(
        time_ms.to_bytes(_TIME_BYTES, "big")
        + len(data).to_bytes(_SIZE_BYTES, "big")
        + data
        for time_ms, data in sorted(messages, key=lambda one: one[0])
    )


def split(content: bytes) -> list[tuple[int, bytes]]:
    """Time in milliseconds and bytes of each message of a file."""
    found = []
    at = 0
    while at < len(content):
        begin = at + _TIME_BYTES + _SIZE_BYTES
        time_ms = int.from_bytes(content[at : at + _TIME_BYTES], "big")
        at, size_at = begin, at + _TIME_BYTES
        at += int.from_bytes(content[size_at:begin], "big")
        found.append((time_ms, content[begin:at]))
    return found


def tell_load(content: bytes) -> str:
    """Sizes of messages, and how much of a channel each station takes on average."""
    sizes: dict[bytes, list[int]] = {}
    messages = split(content)
    for _, data in messages:
        sizes.setdefault(data[_STATION], []).append(len(data))
    every = [len(data) for _, data in messages]
    n_stations = f"{len(sizes)} station{'s' if len(sizes) > 1 else ''}"
    words = (
        f"{len(every)} messages of {min(every)} to {max(every)} bytes from {n_stations}"
    )
    span_s = (messages[-1][0] - messages[0][0]) / 1000.0
    if not span_s:
        return f"{words}."
    rates = [sum(of_station) / span_s for of_station in sizes.values()]
    share = 8.0e-6 * sum(rates) / _CHANNEL_MBPS
    return (
        f"{words} in {span_s:.1f} s: {min(rates):.0f} to {max(rates):.0f} bytes per"
        f" second by station, together {100.0 * share:.2f} % of a channel of"
        f" {_CHANNEL_MBPS:g} Mbit/s, without signatures and headers of the net."
    )


def encode(message: dict[str, Any], release: str = RELEASES[0]) -> bytes:
    """Bytes of a message of :func:`.cpm.build_stations`, unsigned.

    Without headers of the net.
    """
    payload = message["payload"]
    containers = []
    for container in payload["cpmContainers"]:
        data = to_bytes(
            CONTAINERS[container["containerId"]], container["containerData"], release
        )
        containers.append(container | {"containerData": data.hex()})
    whole = message | {"payload": payload | {"cpmContainers": containers}}
    return to_bytes(_MESSAGE, whole, release)


def decode(content: bytes, release: str = RELEASES[0]) -> dict[str, Any]:
    """Message of bytes, the inverse of :func:`encode`."""
    message: dict[str, Any] = from_bytes(_MESSAGE, content, release)
    for container in message["payload"]["cpmContainers"]:
        data = bytes.fromhex(container["containerData"])
        container["containerData"] = from_bytes(
            CONTAINERS[container["containerId"]], data, release
        )
    return message


def to_cpm_uper(
    layout: Layout,
    scene: Scene,
    watched: WatchedRun | None = None,
    *,
    release: str = RELEASES[0],
) -> bytes:
    """Layout's messages by time, as records: see :func:`to_records`.

    A message says which station it is from. Raises InputError as
    :func:`.cpm.build_stations`, MissingExtraError if asn1tools is not installed.
    """
    return to_records(
        (
            message["payload"]["managementContainer"]["referenceTime"],
            encode(message, release),
        )
        for station in build_stations(layout, scene, watched, release=release)
        for message in station.messages
    )


FORMAT = ExportFormat(
    write=to_cpm_uper,
    shows_runs=True,
    options=("release",),
    told=tell_load,
)
