"""Evaluations made up for the report's interactive part, and pages around its
template.
"""

from dataclasses import replace

import numpy as np

from experiments.report.page import page_environment
from geometry.catalogue import load_cameras
from geometry.lidar import load_lidars
from geometry.poses import Pose
from placement.candidates import CandidatePose
from placement.evaluation import Evaluation, Verdict
from placement.layout import Layout
from scenarios.runs import find_onsets

EVIL = "</script><script>alert(1)</script>\u2028\"'<!--&{{ 7 }}"


def build_layout(n_units, *, name="layout", middle_m=(-127.0, 0.0), ids=None):
    """Cameras and LiDARs by turns on a circle, looking inwards."""
    sensors = [next(iter(load_cameras().values())), next(iter(load_lidars().values()))]
    units = []
    for index in range(n_units):
        angle = 2.0 * np.pi * index / n_units
        east, north = np.asarray(middle_m) + 18.0 * np.array(
            [np.cos(angle), np.sin(angle)]
        )
        units.append(
            CandidatePose(
                id=ids[index] if ids else f"unit {index + 1}",
                site_id="",
                pose=Pose(
                    position_m=np.array([east, north, 6.0]),
                    yaw_deg=float(np.degrees(angle)) + 180.0,
                    pitch_deg=-20.0,
                ),
                sensor=sensors[index % len(sensors)],
            )
        )

    return Layout(name=name, units=tuple(units))


def build_evaluation(setting, layout, *, share=0.6, seed=0, with_vam=False):
    """Detections by lot, in stretches; the rest follows from them."""
    rng = np.random.default_rng(seed)
    axis = setting.axis
    rule = setting.rule

    def verdict(detected):
        arrival = np.where(detected, axis.time_s + rule.latency_s, np.inf)
        onsets = find_onsets(arrival, axis, rule=rule)
        return Verdict(
            detected=detected,
            confirmation_time_s=onsets.confirmation_s,
            onset_time_s=onsets.onset_s,
            is_avoided=onsets.is_in_time,
        )

    def draw():
        return np.repeat(rng.random(axis.n_frames // 5 + 1) < share, 5)[: axis.n_frames]

    units = {unit.id: draw() for unit in layout.units}
    vut = draw()
    everyone = np.logical_or.reduce(list(units.values()))
    vam = draw()
    others = {"vam": verdict(vam), "all_sources": verdict(everyone | vut | vam)}
    return Evaluation(
        layout=layout,
        axis=axis,
        vut=verdict(vut),
        units={unit_id: verdict(detected) for unit_id, detected in units.items()},
        rsu_all=verdict(everyone),
        vut_and_rsus=verdict(everyone | vut),
        others=others if with_vam else {},
    )


def with_evil_names(setting):
    """The setting of a junction whose things are called what no thing should be
    called.
    """
    scene = setting.scene
    printable = EVIL.replace("\u2028", "")  # a scene takes no other id
    things = [
        replace(thing, id=f"{printable} {number}")
        for number, thing in enumerate(scene.instances)
    ]
    return replace(
        setting, scene=replace(scene, name=printable, instances=tuple(things))
    )


TABLE = """<table id="sorted"><thead><tr><th scope="col">name</th>
<th scope="col">price (€)</th>
<th scope="col">to spare</th></tr></thead><tbody>
<tr><th scope="row">unit 10</th><td>1 200 €</td><td>avoided, 0.30 s</td></tr>
<tr><th scope="row">unit 9</th><td>\N{MINUS SIGN}5.5 €</td>
<td>HIT, not confirmed</td></tr>
<tr><th scope="row">unit 1</th><td>\N{EN DASH}</td><td>HIT, 0.20 s late</td></tr>
<tr><th scope="row">a unit</th><td>90 €</td><td>avoided, 1.10 s</td></tr>
</tbody></table>"""


def page_around(part):
    """A small page with the interactive part and one more table behind it."""
    template = page_environment().from_string(
        '<!DOCTYPE html><html lang="en"><head><meta'
        ' charset="utf-8"><title>page</title><link rel="icon" href="data:,"><meta'
        ' name="viewport" content="width=device-width, initial-scale=1"><style>body {'
        " margin: 1rem; font: 16px/1.5 sans-serif; } .scroll { overflow-x: auto; } h2 {"
        ' overflow-wrap: anywhere; }{% include "interactive.css"'
        ' %}</style></head><body><main>{% include "interactive.html.j2" %}'
        + TABLE
        + "</main></body></html>"
    )
    return template.render(interactive=part)
