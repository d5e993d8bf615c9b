"""A language made up, and words of a text that are not in it: they were said by no
message.
"""

import re

from experiments.language import Messages
from geometry.catalogue import load_cameras, load_lidars
from geometry.study_scene import load_study_scene
from placement.detectors.registry import DETECTOR_NAMES
from scenarios.cases import load_cases


class Bracketed(Messages):
    """A language made up: English in brackets, but for what is put in."""

    def find(self, message):
        return re.sub(r"(\{[^}]*\})", r"⟧\1⟦", f"⟦{message}⟧").replace("⟦⟧", "")

    def find_plural(self, one, many, count):
        return self.find(one if count == 1 else many)


ALLOWED = {
    "APR",
    "AEB",
    "EUR",
    "Euro",
    "NCAP",
    "VUT",
    "RSU",
    "RSUs",
    "IoU",
    "HiGHS",
    "CarlaNCAP",
}
ALLOWED |= {
    "m",
    "cm",
    "s",
    "ms",
    "px",
    "km",
    "h",
    "Hz",
    "N",
    "x",
    "prices.toml",
    "cost_eur",
}
ALLOWED |= {
    "place-rsus",
    "python",
    "cvxpy",
    "highspy",
    "numpy",
    "scipy",
    "trimesh",
    "embree",
}
ALLOWED |= {"rays", *DETECTOR_NAMES, *load_cases(), *load_cameras(), *load_lidars()}
# A name cut in two, and that of a latency budget.
ALLOWED |= {"carla", "ncap-rgb", "study"}
ALLOWED |= {thing.id for thing in load_study_scene().instances}
ALLOWED |= {site.id for site in load_study_scene().sites}


def left_over(text):
    """Words of a text that no message said; ids, codes and numbers with units are
    none.
    """
    before = None
    while before != text:
        before = text
        text = re.sub(r"⟦[^⟦⟧]*⟧", " ", text)
    tokens = [re.sub(r"^\W+|\W+$", "", token) for token in text.split()]
    return [
        token
        for token in tokens
        if re.search(r"[^\W\d_]", token)
        and not re.search(r"[\d/_\\@]|\.(csv|json|html|png)$", token)
        and token not in ALLOWED
    ]
