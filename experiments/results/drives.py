"""What a result was found on: cases, weathers, perception, refusals, and versions of programs."""

import platform
from importlib.metadata import version
from typing import Annotated

from geometry.raycast import caster_name
from placement.setting import Setting

from .record import Record, Share, says

_PACKAGES = ("cvxpy", "highspy", "numpy", "scipy", "trimesh")
_RAY_PACKAGES = {"open3d": ("open3d-cpu", "open3d"), "embreex": ("embreex",)}


class RefusalRecord(Record, frozen=True, kw_only=True):
    """What the scene has no room for."""

    case: Annotated[str, says("Name of the case.")]
    approach: Annotated[str, says("Arm from which the vehicle would come.")]
    speeds_kmh: Annotated[tuple[float, ...], says("Speeds of the vehicle, in km/h.")]
    reason: Annotated[str, says("Why, in words.")]


class DrivesRecord(Record, frozen=True, kw_only=True):
    """What was driven, and what perceived it: fields of every result."""

    cases: tuple[str, ...]
    weathers: tuple[str, ...]
    detector: str
    vut_sensors: tuple[str, ...]
    packet_loss: Share
    vam_rate: Share
    not_driven: tuple[RefusalRecord, ...]


def build_drives_record(setting: Setting) -> DrivesRecord:
    """Cases and weathers, each once in the order of the runs, perception, and refusals."""
    return DrivesRecord(
        cases=tuple(dict.fromkeys(setting.axis.cases)),
        weathers=tuple(dict.fromkeys(setting.axis.weathers)),
        detector=setting.detector.name,
        vut_sensors=tuple(setting.vut_sensors),
        packet_loss=setting.links.packet_loss,
        vam_rate=setting.links.vam_rate,
        not_driven=tuple(
            RefusalRecord(
                case=refusal.case.name,
                approach=refusal.approach,
                speeds_kmh=tuple(refusal.speeds_kmh),
                reason=refusal.reason,
            )
            for refusal in setting.refusals
        ),
    )


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    rays = caster_name()
    found = {"place-rsus": version("place-rsus"), "python": platform.python_version()}
    found |= {name: version(name) for name in _PACKAGES}
    for package in _RAY_PACKAGES[rays]:
        try:
            found[f"rays: {rays}"] = version(package)
            break
        except ModuleNotFoundError:
            continue
    return found
