"""``place-rsus scene``: makes scenes of maps, shows and checks them."""

from geometry.errors import InputError

from ..language import mark

CAUSES = {
    "no lane": mark("No car can enter the junction: the map has no lane into it."),
    "no road": mark("On the map, no road ends at the junction."),
    "no site": mark("There is no pole or other place that could carry another sensor."),
    "no run": mark(
        "None of the requested collisions is possible there: roads or space are"
        " missing."
    ),
    "no accident": mark(
        "No known accident nearby resembles one of its collisions, so they have no"
        " weight."
    ),
    "time": mark("It exceeded its time limit."),
    "memory": mark("It exceeded its memory limit."),
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
