"""Euro NCAP cases, where they are driven at a junction, and the braking that may help.

``load_cases()`` has all cases, ``pick_cases()`` those that a user names. ``build_runs()`` lays them
on the arms of a junction, by the study's own start points where there are any, else by the rules
of the protocol; every run lies on a grid of frames that ends at the unbraked impact.
``last_brake_time_s()`` says when braking is too late, ``weigh()`` how much each run counts.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .aeb import AebRule, last_brake_time_s, load_aeb_rule
    from .cases import Case, load_cases, pick_cases
    from .exposure import weigh
    from .runs import FrameAxis, Refusal, Run, build_frame_axis, build_runs

__all__ = [
    "AebRule",
    "Case",
    "FrameAxis",
    "Refusal",
    "Run",
    "build_frame_axis",
    "build_runs",
    "last_brake_time_s",
    "load_aeb_rule",
    "load_cases",
    "pick_cases",
    "weigh",
]

# Loaded when first used.
_HOMES = {
    "aeb": ("AebRule", "last_brake_time_s", "load_aeb_rule"),
    "cases": ("Case", "load_cases", "pick_cases"),
    "exposure": ("weigh",),
    "runs": ("FrameAxis", "Refusal", "Run", "build_frame_axis", "build_runs"),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return __all__
