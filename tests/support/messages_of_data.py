"""Texts of data files, and names in code, that answers say as they are.

Keys of translations.
"""

from geometry.junction import ARM_NAMES
from geometry.phrases import Phrase
from geometry.terrain import GROUND
from geometry.weather import load_weathers
from placement.detectors.evidence import VRU_CLASSES
from placement.ground import BANDS
from placement.latency import load_latency_budgets
from placement.retrofit import load_labour
from placement.wishes import load_prices
from scenarios.cases import ROAD_USER_GROUPS, load_cases, load_unlaid_cases, worded_for

FUSIONS = ("any", "single")
BODIES = (
    "parked-car-small and parked-car-large",
    "parked-car-large and parked-car-small",
)
"""Parked cars of a case, in reasons why there is no room for them."""
SIDES = ("near", "far")


def messages_of_data():
    """Each message with the file or the name that has it."""
    cases = [*load_cases().values(), *load_unlaid_cases().values()]
    both = [
        worded_for(case, keeps_left=keeps_left)
        for case in cases
        for keeps_left in (0, 1)
    ]
    titles = {template for case in both for template in templates(case.title)}
    parts = [
        part.name for budget in load_latency_budgets().values() for part in budget.parts
    ]
    texts = {
        "scenarios/data/*cases.toml: title": titles,
        "scenarios/data/unlaid_cases.toml": [
            one.not_laid for one in load_unlaid_cases().values()
        ],
        "geometry/data/weather.toml": load_weathers(),
        "placement/data/latency.toml": parts,
        "placement/data/labour.toml": [load_labour().source],
        "placement/data/prices.toml": load_prices().kinds,
        "placement/data/pixel_densities.toml": [name for name, _ in BANDS],
        "geometry/junction.py": ARM_NAMES,
        "geometry/terrain.py": [GROUND],
        "geometry/data/actors.toml": {case.vru.name for case in load_cases().values()},
        "scenarios/obstructions.py": BODIES,
        "placement/detectors/evidence.py": VRU_CLASSES,
        "scenarios/cases.py": [*ROAD_USER_GROUPS, *SIDES],
        "placement/question.py": FUSIONS,
    }
    found = {}
    for where, messages in texts.items():
        for message in messages:
            found.setdefault(message, []).append(where)
    return found


def templates(text):
    """Templates of a phrase and of those within it."""
    within = [value for value in text.fields.values() if isinstance(value, Phrase)]
    return {text.template}.union(*map(templates, within))
