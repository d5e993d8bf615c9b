"""What units detect is cached for the next call: it looks at nothing again, and finds
the same.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from changes import changed
from tiny_worlds import unit_at

from geometry.actors import pick_actor
from geometry.catalogue import pick_camera
from geometry.lidar import load_lidars
from geometry.weather import load_weathers
from placement.compute import Compute
from placement.detectors import load_detector
from placement.detectors.evidence import Detections
from placement.evaluator import evaluate as watch_module
from placement.evaluator import evaluate_layout
from placement.layout import Layout

WALL = (
    (5.0, 0.2, 0.0),
    (5.3, 4.0, 3.0),
)


def unit(name, yaw_deg=0.0, sensor=None):
    """A camera at a pole, 3 m high."""
    return unit_at(
        name,
        [0.0, 0.0, 3.0],
        yaw_deg=yaw_deg,
        pitch_deg=-5.0,
        site_id="pole",
        sensor=sensor,
    )


LAYOUT = Layout(name="two", units=(unit("a"), unit("b", 30.0)))


@pytest.fixture
def runs(build_run):
    """An adult who crosses 12 m ahead, and one who comes back."""
    adult = pick_actor("adult", "test")
    n = 21
    along = np.column_stack(
        [np.full(n, 12.0), np.linspace(-4.0, 4.0, n), np.full(n, 90.0)]
    )
    back = build_run(adult, along[::-1])
    return [build_run(adult, along), replace(back, id="other")]


@pytest.fixture
def setting(build_scene, build_setting, runs):
    """The runs beside a wall."""
    return build_setting(build_scene(WALL), runs)


@pytest.fixture
def ask(setting, tmp_path):
    """Evaluates two units with a cache, or other ones in another setting."""
    compute = Compute(workers=1, cache_folder=tmp_path)

    def evaluate(asked=setting, layout=LAYOUT, **options):
        return evaluate_layout(layout, asked, compute=replace(compute, **options))

    return evaluate


class NeverFinds:
    """A network that takes a minute for each picture, in which it finds nobody."""

    name = "net"
    needs_pictures = True
    seconds_per_picture = 60.0
    min_box_height_px = 1.0
    lidar = None

    def detect(self, evidence, rng):
        row_index = np.zeros(0, dtype=np.int64)
        return Detections(
            row_index=row_index,
            boxes_px=np.zeros((0, 4)),
            confidence=np.zeros(0),
        )


@pytest.fixture
def looked(monkeypatch):
    """What was looked from, call by call: the ids of units, and whether the VUT looked,
    too.
    """
    calls = []
    look = watch_module._Watcher.look

    def noted(self, units, *, with_vut):
        calls.append((sorted(one.id for one in units.values()), with_vut))
        return look(self, units, with_vut=with_vut)

    monkeypatch.setattr(watch_module._Watcher, "look", noted)
    return calls


def assert_same(one, other):
    """Every party's verdict is the same in two evaluations."""
    for name, verdict in (
        ("vut", one.vut),
        ("rsu_all", one.rsu_all),
        *one.units.items(),
    ):
        again = {
            "vut": other.vut,
            "rsu_all": other.rsu_all,
            **other.units,
        }[name]
        for field in ("detected", "confirmation_time_s", "onset_time_s", "is_avoided"):
            expected = getattr(again, field)
            assert np.array_equal(getattr(verdict, field), expected, equal_nan=True)


@pytest.mark.parametrize("detector", ["geometric", "response"])
def test_the_second_call_looks_at_nothing_and_finds_the_same(
    setting, ask, looked, detector
):
    setting = replace(setting, detector=load_detector(detector))

    first = ask(setting)

    assert first.rsu_all.detected.any()
    assert not first.rsu_all.detected.all()

    again = ask(setting)

    assert looked == [(["a", "b"], True)]
    assert_same(again, first)
    assert_same(ask(setting, cache_folder=None), first)
    assert len(looked) == 2


def test_only_new_poses_are_looked_from(ask, looked):
    ask()
    moved = unit("moved", 30.0 + 1.0e-9)
    lidar = unit("lidar", sensor=load_lidars()["carla-ncap-lidar"])
    renamed = replace(LAYOUT.units[0], id="renamed")

    layout = Layout(name="three", units=(moved, lidar, renamed))

    found = ask(layout=layout)

    assert looked[1:] == [(["lidar", "moved"], False)]
    assert_same(found, ask(layout=layout, cache_folder=None))


@pytest.mark.parametrize(
    "change",
    [
        {"vut_sensors": ("camera", "lidar")},
        {"vut_camera": pick_camera("carla-ncap-rgb-90", "test")},
    ],
    ids=lambda change: next(iter(change)),
)
def test_what_the_vut_looks_with_is_looked_with_anew(setting, ask, looked, change):
    ask()
    ask(replace(setting, **change))

    assert looked[1:] == [([], True)]


def _with_run(setting, **changes):
    """The setting with its first run changed."""
    first, *others = setting.runs
    return replace(setting, runs=(replace(first, **changes), *others))


CHANGES = {
    "scene": lambda s: changed(
        s, "scene.vertices_m", s.scene.vertices_m + [0.0, 0.0, 1.0e-6]
    ),
    "weather": lambda s: _with_run(s, weather="fog"),
    "VRU's way": lambda s: _with_run(
        s, vru_position_m=s.runs[0].vru_position_m + 1.0e-6
    ),
    "VUT's way": lambda s: _with_run(s, vut_yaw_deg=s.runs[0].vut_yaw_deg + 1.0),
    "shapes": lambda s: _with_run(s, vru_shape=s.runs[0].vru_shape[::-1]),
    "detector": lambda s: changed(s, "detector.min_iou", 0.51),
    "another detector": lambda s: replace(s, detector=load_detector("response")),
}


@pytest.mark.parametrize("change", CHANGES)
def test_whatever_changes_what_is_seen_is_looked_at_anew(setting, ask, looked, change):
    ask()
    ask(CHANGES[change](setting))
    expected = [(["a", "b"], True)] * 2

    assert looked == expected


def test_seed_weathers_and_version_are_part_of_the_key(ask, looked, monkeypatch):
    ask()
    ask(seed=1)
    dim = replace(load_weathers()["day"], contrast=0.5)
    with monkeypatch.context() as patch:
        patch.setattr(watch_module, "pick_weather", lambda name, where: dim)
        ask()

    monkeypatch.setattr(watch_module, "_KIND", "place-rsus/views/0")
    ask()
    expected = [(["a", "b"], True)] * 4

    assert looked == expected


def test_what_a_network_finds_is_not_kept(setting, tmp_path):
    kept = watch_module._open_cache(
        replace(setting, detector=NeverFinds()), Compute(cache_folder=tmp_path)
    )
    kept.add({"a": np.zeros(1)})

    assert not list(tmp_path.iterdir())


def test_how_long_a_network_will_look_is_told_before_it_begins(setting, caplog):
    told = []

    class Network(NeverFinds):
        def detect(self, evidence, rng):
            told.append(caplog.text)
            return super().detect(evidence, rng)

    evaluate_layout(LAYOUT, replace(setting, detector=Network()))

    # A picture takes a minute.
    line = r"([1-9]\d+) pictures for the network: about \1 minutes of processor time"

    assert told
    for text in told:
        assert re.search(line, text)
