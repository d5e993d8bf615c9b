"""``place-rsus scene``: makes scenes of maps, shows and checks them."""

from geometry.errors import InputError

from ..language import mark

CAUSES = {
    "no lane": mark("No car can drive into it: the map has no lane that leads in."),
    "no road": mark("On the map no road ends at it."),
    "no site": mark("There is no pole or other place that could carry another sensor."),
    "no run": mark(
        "None of the collisions asked for can happen there: roads or room are missing."
    ),
    "no accident": mark(
        "No known accident near it is like one of its collisions: nothing weighs them."
    ),
    "time": mark("It took longer than it was given."),
    "memory": mark("It took more memory than it was given."),
}
"""Why a junction is left out, in plain words."""
_CAUSE_OF = {
    **{
        "junction": "no lane",
        "lanes": "no road",
        "sites": "no site",
        "candidates": "no site",
    },
    **dict.fromkeys(("runs", "cases", "approaches"), "no run"),
    **dict.fromkeys(("near", "weights"), "no accident"),
}


def cause_of(error: InputError) -> str:
    """Why a junction is left out, by the field that an error names."""
    return _CAUSE_OF.get(error.where.rpartition(": ")[2].partition(" ")[0], "")
