"""Collective perception messages as the bytes that are sent: unaligned packed encoding (UPER)."""

import importlib
import json
from functools import cache
from importlib.resources import files
from typing import Any

from geometry.errors import MissingExtraError
from geometry.scene import Scene
from placement.layout import Layout

from .cpm import RELEASES, build_stations
from .formats import ExportFormat
from .watched import WatchedRun

_MESSAGE = "CollectivePerceptionMessage"
CONTAINERS = {
    2: "OriginatingRsuContainer", 3: "SensorInformationContainer", 5: "PerceivedObjectContainer"
}  # fmt: skip
_TIME_BYTES, _SIZE_BYTES = 8, 4
_CHANNEL_MBPS = 6.0  # ITS-G5's default data rate: ETSI EN 302 663


@cache
def _codecs(release: str) -> tuple[Any, Any]:
    """UPER's and JSON's rules of ``data/cpm.asn``, with the lines of a release."""
    try:
        asn1tools = importlib.import_module("asn1tools")
    except ImportError:
        raise MissingExtraError("cpm-uper needs asn1tools: pip install place-rsus[v2x]") from None
    others = tuple(f"-- {other}" for other in RELEASES if other != release)
    text = (files("experiments") / "data" / "cpm.asn").read_text(encoding="utf-8")
    lines = "\n".join(line for line in text.splitlines() if not line.endswith(others))
    return asn1tools.compile_string(lines, "uper"), asn1tools.compile_string(lines, "jer")


def encode(message: dict[str, Any], release: str = RELEASES[0]) -> bytes:
    """Bytes of a message of :func:`.cpm.build_stations`, unsigned, without headers of the net."""
    uper, jer = _codecs(release)

    def to_bytes(name: str, value: object) -> bytes:
        content: bytes = uper.encode(name, jer.decode(name, json.dumps(value).encode()))
        return content

    payload = message["payload"]
    containers = []
    for container in payload["cpmContainers"]:
        data = to_bytes(CONTAINERS[container["containerId"]], container["containerData"])
        containers.append(container | {"containerData": data.hex()})
    return to_bytes(_MESSAGE, message | {"payload": payload | {"cpmContainers": containers}})


def decode(content: bytes, release: str = RELEASES[0]) -> dict[str, Any]:
    """Message of bytes, the inverse of :func:`encode`."""
    uper, jer = _codecs(release)

    def from_bytes(name: str, data: bytes) -> Any:
        return json.loads(jer.encode(name, uper.decode(name, data)))

    message: dict[str, Any] = from_bytes(_MESSAGE, content)
    for container in message["payload"]["cpmContainers"]:
        data = bytes.fromhex(container["containerData"])
        container["containerData"] = from_bytes(CONTAINERS[container["containerId"]], data)
    return message


def to_cpm_uper(
    layout: Layout, scene: Scene, watched: WatchedRun | None = None, *, release: str = RELEASES[0]
) -> bytes:
    """Layout's messages, by time: reference time (8 bytes), size (4), both big-endian, and bytes.

    Times are in milliseconds; the message says which station it is from. Raises InputError as
    :func:`.cpm.build_stations`, MissingExtraError if asn1tools is not installed.
    """
    messages = [
        message
        for station in build_stations(layout, scene, watched, release=release)
        for message in station.messages
    ]
    messages.sort(key=_time_ms)
    parts = []
    for message in messages:
        time_ms, data = _time_ms(message), encode(message, release)
        head = time_ms.to_bytes(_TIME_BYTES, "big") + len(data).to_bytes(_SIZE_BYTES, "big")
        parts.append(head + data)
    return b"".join(parts)


def _time_ms(message: dict[str, Any]) -> int:
    time_ms: int = message["payload"]["managementContainer"]["referenceTime"]
    return time_ms


def split(content: bytes) -> list[tuple[int, bytes]]:
    """Reference time in milliseconds and bytes of each message of a file."""
    found, at = [], 0
    while at < len(content):
        begin = at + _TIME_BYTES + _SIZE_BYTES
        time_ms = int.from_bytes(content[at : at + _TIME_BYTES], "big")
        at, size_at = begin, at + _TIME_BYTES
        at += int.from_bytes(content[size_at:begin], "big")
        found.append((time_ms, content[begin:at]))
    return found


def tell_load(content: bytes) -> str:
    """Sizes of messages, and how much of a channel each station takes on average."""
    sizes: dict[int, list[int]] = {}
    messages = split(content)
    for _, data in messages:
        # Behind protocol version and message id.
        sizes.setdefault(int.from_bytes(data[2:6], "big"), []).append(len(data))
    every = [size for of_station in sizes.values() for size in of_station]
    words = (
        f"{len(every)} messages of {min(every)} to {max(every)} bytes from {len(sizes)} stations"
    )
    span_s = (messages[-1][0] - messages[0][0]) / 1000.0
    if not span_s:
        return f"{words}."
    rates = [sum(of_station) / span_s for of_station in sizes.values()]
    share = 8.0e-6 * sum(rates) / _CHANNEL_MBPS
    return (
        f"{words} in {span_s:.1f} s: {min(rates):.0f} to {max(rates):.0f} bytes per second by "
        f"station, together {100.0 * share:.2f} % of a channel of {_CHANNEL_MBPS:g} Mbit/s, "
        "without signatures and headers of the net."
    )


FORMAT = ExportFormat(
    write=to_cpm_uper,
    content="the same messages as bytes (UPER); extra: v2x",
    is_binary=True,
    shows_runs=True,
    options=("release",),
    told=tell_load,
)
