"""``place-rsus certify``: a gap over worlds, written and checked again."""

import pytest
from command_results import answer, refusal
from json_files import read_json, write_json

ASKED = (
    *("certify", "--cases", "CPNC-50", "--approaches", "east", "--along-arms", 0),
    *("--within", "carlancap-12", "--budget", 1, "--detector", "response", "--quiet"),
    *("--samples", 2, "--blocks", 2, "--judge", 3),
)


# Quickly: tests/placement/sampling/test_certify.py
@pytest.mark.long
def test_a_gap_is_told_written_and_verified_and_a_smaller_one_is_not(run, tmp_path):
    folder = tmp_path / "results"
    out = answer(run(*ASKED, "--out", folder))
    path = folder / "certified.json"
    found = read_json(path)
    first = " ".join(out.split("Over all worlds")[0].split())

    assert first.startswith(f"1 unit at {found['units'][0]} prevents ")
    assert (
        f"at most {100.0 * found['gap']:.2f} points more (with 95 % confidence)"
        in first
    )
    assert max(map(len, out.splitlines()[:-1])) <= 80  # but the path
    assert found["gap"] == pytest.approx(found["most"] - found["least"])

    out = answer(run("verify", folder, "--quiet"))
    assert (
        "3 checks: all OK. Not checked: what is listed above, who made it (--key)."
        in out
    )

    write_json(path, found | {"gap": found["gap"] - 0.001})
    code, out, _ = run("verify", folder, "--quiet")

    assert code == 1
    assert "FAILED numbers: gap: " in out

    above_one = [1.5, *found["apr_by_world"][1:]]
    for key, value, where in (
        ("pool", [], "pool"),
        ("blocks", [], "blocks"),
        ("apr_by_world", [], "apr_by_world"),
        ("apr_by_world", above_one, "samples"),
    ):
        write_json(path, found | {key: value})
        assert refusal(run("verify", folder, "--quiet")).startswith(
            f"{path}: {where}: got "
        )


# Quickly: tests/placement/sampling/test_certify.py, and above with a number
@pytest.mark.long
def test_worlds_of_a_block_may_be_found_out(run, ask, tmp_path):
    found = ask(*ASKED, "--samples auto --out", tmp_path / "results")
    growth = found["growth"]

    assert found["worlds_of_block"] == growth["taken"]
    assert [block["first"] for block in found["blocks"]] == [0, growth["taken"]]
    assert {one["worlds"] for one in growth["rounds"]} >= {growth["taken"]}

    out = answer(run("verify", tmp_path / "results", "--quiet"))
    assert "3 checks: all OK." in out


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (("--blocks", 1), "--blocks: got '1'; expected a whole number, at least 2"),
        (("--samples", 1), "--samples: got 1; expected a whole number, at least 2"),
        (
            ("--samples", "often"),
            (
                "--samples: got 'often'; expected auto, or a number of sampled worlds,"
                " 0 to 100,000"
            ),
        ),
        (("--judge", 0), "--judge: got '0'; expected a whole number, at least 2"),
        (("--budget", 0), "--budget: got '0'"),
    ],
)
def test_what_cannot_be_certified_is_one_line(run, tmp_path, changed, message):
    assert refusal(run(*ASKED, *changed, "--out", tmp_path / "results")).startswith(
        f"{message}"
    )
    assert not (tmp_path / "results").exists()


def test_worlds_to_compare_in_are_a_number(run):
    assert refusal(run("compare carlancap-12 carlancap-12 --samples auto")) == (
        "--samples: got 'auto'; expected a number; auto where the best"
        " layout within a budget is chosen"
    )
