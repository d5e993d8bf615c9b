"""Names of all cases for a test of each: quickly of one per family and impact face."""

import pytest

from scenarios.cases import load_cases


def case_names(does_count=lambda case: True):
    """Names of those cases that count."""
    quick = {}
    for name, case in load_cases().items():
        quick.setdefault((case.family, case.impact_face), name)
    return [
        name if name in quick.values() else pytest.param(name, marks=pytest.mark.long)
        for name, case in load_cases().items()
        if does_count(case)
    ]
