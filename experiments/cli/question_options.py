"""How the command line shows each field of a question; its help is the field's description."""

import re
from dataclasses import dataclass

from placement.question import QuestionField, question_fields

ASKED = "What is asked"
MOUNTED = "What may be mounted, and where"
SOUGHT = "How it is looked for"
DRIVEN = "What is driven"
SEEN = "What is seen, told and braked"
SECTIONS = (ASKED, MOUNTED, SOUGHT, DRIVEN, SEEN)


@dataclass(frozen=True, slots=True)
class Shown:
    """The option of a field of :class:`placement.question.Question`."""

    section: str  # of the help
    metavar: str = ""  # what the help shows for a value; empty: what the type says
    is_common: bool = False  # most people need it: the short help shows it
    is_path: bool = False  # a shell completes the value as a path
    takes_infinity: bool = False
    needs: str = ""  # field without which this one has no effect
    excludes: str = ""  # field with which this one has no effect


OPTIONS = {
    "budget": Shown(ASKED, is_common=True),
    "budget_cost": Shown(ASKED, metavar="EUR", is_common=True),
    "target": Shown(ASKED, metavar="SHARE", is_common=True),
    "least": Shown(ASKED, is_common=True, needs="target"),
    "min_case_apr": Shown(ASKED),
    "survive": Shown(ASKED, metavar="N|unit|site", is_common=True),
    "keep": Shown(MOUNTED, metavar="LAYOUT", is_common=True, is_path=True),
    "within": Shown(MOUNTED, metavar="LAYOUT", is_common=True, is_path=True),
    "force_site": Shown(MOUNTED, metavar="SITES"),
    "forbid_site": Shown(MOUNTED, metavar="SITES"),
    "site_capacity": Shown(MOUNTED),
    "site_cost_eur": Shown(MOUNTED, metavar="EUR"),
    "separation_m": Shown(MOUNTED, metavar="METRES"),
    "sensors": Shown(MOUNTED, metavar="NAMES", is_common=True, excludes="within"),
    "heights": Shown(MOUNTED, metavar="METRES"),
    "yaw_step_deg": Shown(MOUNTED, metavar="DEGREES"),
    "pitches": Shown(MOUNTED, metavar="DEGREES"),
    "no_look": Shown(MOUNTED, metavar="FILE", is_path=True),
    "no_look_share": Shown(MOUNTED, needs="no_look"),
    "solver": Shown(SOUGHT),
    "time_limit_s": Shown(SOUGHT, metavar="SECONDS", is_common=True),
    "gap": Shown(SOUGHT),
    "refine": Shown(SOUGHT, is_common=True),
    "samples": Shown(SOUGHT),
    "uncertainty": Shown(SOUGHT, metavar="NAME", needs="samples"),
    "traffic": Shown(SOUGHT, metavar="sumo|FILE", is_path=True, needs="samples"),
    "traffic_offset": Shown(SOUGHT, metavar="EAST,NORTH", needs="traffic"),
    "risk": Shown(SOUGHT, metavar="HOW", needs="samples"),
    "pool": Shown(SOUGHT),
    "scene": Shown(DRIVEN, metavar="PATH", is_common=True, is_path=True),
    "junction": Shown(DRIVEN, metavar="NAME", is_common=True),
    "at": Shown(DRIVEN, metavar="X,Y"),
    "sites": Shown(DRIVEN, metavar="WHERE"),
    "driving_side": Shown(DRIVEN),
    "cases": Shown(DRIVEN, metavar="CASES", is_common=True),
    "case_range": Shown(DRIVEN),
    "protect": Shown(DRIVEN, is_common=True),
    "along_arms": Shown(DRIVEN, metavar="METRES", is_common=True),
    "speeds": Shown(DRIVEN, metavar="KMH"),
    "approaches": Shown(DRIVEN, metavar="ARMS"),
    "weather": Shown(DRIVEN, metavar="WEATHER", is_common=True),
    "force": Shown(DRIVEN, needs="speeds"),
    "strict": Shown(DRIVEN),
    "weights": Shown(DRIVEN, metavar="HOW"),
    "near": Shown(DRIVEN, metavar="LAT,LON", needs="weights"),
    "accidents_within_m": Shown(DRIVEN, metavar="METRES", needs="weights"),
    "score": Shown(DRIVEN),
    "fusion": Shown(SEEN, is_common=True),
    "detector": Shown(SEEN, metavar="HOW", is_common=True),
    "vut_sensors": Shown(SEEN, metavar="SENSORS"),
    "packet_loss": Shown(SEEN),
    "vam_rate": Shown(SEEN),
    "n_confirmations": Shown(SEEN),
    "track_memory_s": Shown(SEEN, metavar="SECONDS", takes_infinity=True),
    "latency_s": Shown(SEEN, metavar="SECONDS"),
    "latency_budget": Shown(SEEN, metavar="NAME|FILE"),
    "deceleration_mps2": Shown(SEEN, metavar="M/S2"),
    "build_up_s": Shown(SEEN, metavar="SECONDS"),
}
"""One for each field, in the fields' order."""


def option_of(field: QuestionField) -> str:
    """The option of a field, such as "--site-cost"."""
    return "--" + field.key.replace("_", "-")


def help_of(field: QuestionField) -> str:
    """A field's description with options in place of the other fields' names."""
    known = question_fields()

    def named(found: re.Match[str]) -> str:
        return option_of(known[found[1]]) if found[1] in known else found[0]

    return re.sub("`([a-z_0-9]+)`", named, field.description)
