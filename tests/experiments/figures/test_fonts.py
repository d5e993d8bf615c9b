"""Names in letters that the default font lacks."""

from matplotlib.font_manager import FontProperties, fontManager

from experiments.figures import fonts
from experiments.figures.fonts import families_for
from experiments.figures.labels import arm_names
from geometry.maps.importing import ImportOptions, import_scene

from ...support.osm_text import OsmText


def crossing(name, tmp_path):
    """A crossing of two streets of one name."""
    osm = OsmText()
    middle = osm.node(0.0, 0.0, highway="traffic_signals")
    for ends in (
        ((-150.0, 0.0), (150.0, 0.0)),
        ((0.0, -150.0), (0.0, 150.0)),
    ):
        before, after = (osm.node(*end) for end in ends)
        tags = {"highway": "primary", "lanes": "2", "name": name}
        osm.way([before, middle, after], tags)

    return import_scene([osm.write(tmp_path)], ImportOptions()).scene


def test_letters_of_the_default_font_need_no_other_one():
    """Umlauts are among them."""
    assert families_for("Mill Street") == ()
    assert families_for("Müllerstraße") == ()


def test_letters_that_no_font_has_are_found_out():
    families_for.cache_clear()
    # A code point for private use: no font of a test machine draws it.
    assert families_for("\U0010fffd") is None


def test_another_font_is_asked_beside_the_default_one(monkeypatch):
    """Where one with Chinese letters is installed."""
    found = families_for("北大街")
    installed = {font.name for font in fontManager.ttflist}
    if found is None:
        assert not any("CJK" in name for name in installed)
    else:
        assert found[0] == FontProperties().get_name()
        assert found[1] in installed


def test_a_street_that_cannot_be_drawn_is_named_by_its_arm(tmp_path, monkeypatch):
    scene = crossing("Mühlenstraße", tmp_path)
    middle = scene.outline_m.mean(axis=0)
    drawn = {label.text for label in arm_names(scene, middle, 60.0)}

    assert "Mühlenstraße (north)" in drawn

    monkeypatch.setattr(fonts, "families_for", lambda text: None)
    drawn = {label.text for label in arm_names(scene, middle, 60.0)}

    assert drawn == {"north arm", "east arm", "south arm", "west arm"}
