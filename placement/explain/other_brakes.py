"""The last moments to brake, had the car other brakes: the same for every layout."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geometry.arrays import FloatArray
from scenarios.aeb import AebRule, last_brake_time_s

from ..cache import CachedArrays, Fingerprints
from ..compute import Compute
from ..setting import Setting

_KIND = "place-rsus/braking/1"  # raise it whenever the same encounters give other brake times


def find_last_brake_times(
    setting: Setting, decelerations_mps2: Sequence[float], *, compute: Compute
) -> dict[float, FloatArray]:
    """Last brake time of every run, (n_runs,) each, by the deceleration [s].

    What is kept of an earlier call is not found again.
    """
    if not decelerations_mps2:
        return {}
    hashes = Fingerprints()
    rules = {value: replace(setting.rule, deceleration_mps2=value) for value in decelerations_mps2}
    names = {value: hashes.of(rule) for value, rule in rules.items()}
    fingerprint = ""
    if compute.cache_folder is not None:
        fingerprint = hashes.of(_KIND, [run.encounter for run in setting.runs])
    kept = CachedArrays(compute.cache_folder, "braking", kind=_KIND, fingerprint=fingerprint)
    kept.add(
        {
            name: _last_brake_times_s(setting, rules[value])
            for value, name in names.items()
            if name not in kept.arrays
        }
    )
    return {value: kept.arrays[name] for value, name in names.items()}


def _last_brake_times_s(setting: Setting, rule: AebRule) -> FloatArray:
    """Of every run, (n_runs,); runs that differ by weather alone share it."""
    encounters = {id(run.encounter): run.encounter for run in setting.runs}
    last_s = {key: last_brake_time_s(encounter, rule) for key, encounter in encounters.items()}
    return np.array([last_s[id(run.encounter)] for run in setting.runs])
