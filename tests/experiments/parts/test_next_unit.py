from dataclasses import replace

from experiments.parts.next_unit import (
    Exchange,
    next_unit_sentence,
    other_sensor_sentence,
    section,
)
from placement.explain.contributions import NextUnit


def test_what_the_next_unit_buys_and_how_that_is_known():
    unit = NextUnit(pose="mast-w/7m", apr=0.974, gain=0.064)
    assert next_unit_sentence(unit, "APR") == (
        "One more unit would add 6.4 points of APR: 97.4 % with mast-w/7m (on the detection table, "
        "by greedy choice)"
    )
    useless = NextUnit(pose="mast-w/7m", apr=0.9, gain=0.0)
    assert next_unit_sentence(useless, "APR") == (
        "One more unit among the candidates would avoid nothing more (on the detection table, by "
        "greedy choice)"
    )
    assert next_unit_sentence(None, "APR") == ""


LENS = Exchange(
    model="basler-aca1920-50gc-16mm",
    kind="camera",
    unit="U2",
    horizontal_fov_deg=38.0,
    yaw_deg=-60.0,
    pitch_deg=-15.0,
    apr=0.974,
    gain=0.064,
    extra_eur=400.0,
    all_units=3,
    apr_all=0.7,
    apr_not_turned=0.5,
    extra_all_eur=1200.0,
)


def test_what_a_longer_lens_buys_and_how_that_is_known():
    assert other_sensor_sentence((LENS,), "APR") == (
        "basler-aca1920-50gc-16mm (38 deg wide) in place of U2 would add 6.4 points of APR: 97.4 % "
        "for 400 EUR more (on the detection table, at the same mounts, turned by up to 45 deg)"
    )
    worse = replace(LENS, apr=0.9, gain=-0.01, extra_eur=-100.0)
    assert other_sensor_sentence((worse, worse), "APR") == (
        "None of 2 other models in place of one of these would add anything: "
        "basler-aca1920-50gc-16mm (38 deg wide) in place of U2 would come closest, with 90.0 % (on "
        "the detection table, at the same mounts, turned by up to 45 deg)"
    )
    assert other_sensor_sentence((), "APR") == ""


def test_the_section_has_a_row_per_model_and_both_sentences():
    unit = NextUnit(pose="mast-w/7m", apr=0.974, gain=0.064)
    said, table = section(unit, (LENS,), "score").blocks
    sentences = (next_unit_sentence(unit, "score"), other_sensor_sentence((LENS,), "score"))
    assert said == " ".join(f"{sentence}." for sentence in sentences)
    assert said.count("points of score") == 2
    assert table.rows == [
        [LENS.model, "38", "U2", "97.4 %", "+6.4", "+400", "70.0 %", "50.0 %", "+1,200"]
    ]
    assert section(None, (), "APR") is None
