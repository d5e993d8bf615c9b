"""``certificate.json``: written, read again, and refused where it is wrong."""

import json
from dataclasses import replace

import numpy as np
import pytest
from certified import document_of, two_of_twelve

from geometry.errors import InputError
from placement.layout import Certificate
from placement.optimiser import solve_placement
from placement.proof_files import CERTIFICATE_FILE, INSTANCE_FILE, save_certificate
from placement.verification.certificates import load_certificate
from placement.verification.recomputation import stage_names


@pytest.fixture
def problem(frame_axis, rule):
    """The best two of twelve poses."""
    return two_of_twelve(frame_axis, rule)


@pytest.fixture
def document(problem):
    """The certificate of the problem, as written."""
    return document_of(problem, solve_placement(problem))


def test_a_certificate_can_be_read_again(problem, document, tmp_path):
    save_certificate(tmp_path, document, problem)

    assert sorted(entry.name for entry in tmp_path.iterdir()) == [
        CERTIFICATE_FILE,
        INSTANCE_FILE,
    ]

    text = (tmp_path / CERTIFICATE_FILE).read_text(encoding="utf-8")

    assert json.loads(text, parse_constant=pytest.fail) == document

    stored = load_certificate(tmp_path / CERTIFICATE_FILE)

    solution = solve_placement(problem)

    assert stored.pose_index == solution.pose_index
    assert [stage.name for stage in stored.stages] == list(stage_names(problem))

    expected = [stage.objective for stage in solution.certificate.stages]

    assert [stage.objective for stage in stored.stages] == expected
    assert stored.is_proven


def test_an_infinite_gap_survives_json(problem, tmp_path):
    solution = solve_placement(problem)
    first, *others = solution.certificate.stages
    certificate = Certificate(
        stages=(replace(first, objective=0.0, gap=np.inf), *others), solver="none"
    )
    document = document_of(problem, replace(solution, certificate=certificate))

    save_certificate(tmp_path, document, problem)

    assert load_certificate(tmp_path / CERTIFICATE_FILE).stages[0].gap == np.inf


# Bad files


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda d: d.pop("schema"),
            "schema: got None; expected place-rsus/certificate/1",
        ),
        (lambda d: d.pop("instance"), r"instance: got nothing"),
        (lambda d: d["instance"].pop("sha256"), "instance.sha256: got nothing"),
        (
            lambda d: d.update(layout=[]),
            r"layout: got \[\]; expected a list of at least one",
        ),
        (lambda d: d["layout"].append(1), r"layout\[2\]: got 1; expected a table"),
        (
            lambda d: d["layout"][0].update(row=-1),
            r"layout\[0\].row: got -1; expected a whole",
        ),
        (lambda d: d["layout"][0].pop("pose"), r"layout\[0\].pose: got nothing"),
        (lambda d: d["layout"][0].update(unit="U1"), r"layout\[0\].unit: got 'U1'"),
        (lambda d: d.update(stages=[]), r"stages: got \[\]"),
        (
            lambda d: d["stages"][0].update(bound=None),
            r"stages\[0\].bound: got None; expected a",
        ),
        (
            lambda d: d["stages"][0].update(objective=float("nan")),
            r"stages\[0\].objective: got",
        ),
        (
            lambda d: d["stages"][0].update(is_proven=1),
            r"stages\[0\].is_proven: got 1; expected",
        ),
        (lambda d: d.update(solver=""), "solver: got ''; expected text"),
        (lambda d: d["presolve"].update(n_runs=[1]), r"presolve.n_runs: got \[1\]"),
    ],
)
def test_a_field_that_is_wrong_is_named(problem, document, tmp_path, change, message):
    change(document)
    path = tmp_path / CERTIFICATE_FILE
    path.write_text(json.dumps(document), encoding="utf-8")

    with pytest.raises(InputError, match=rf"certificate\.json[:.] ?{message}"):
        load_certificate(path)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff", b"[" * 100_000, b"9" * 5000])
def test_a_file_that_is_no_certificate_is_refused(tmp_path, content):
    path = tmp_path / CERTIFICATE_FILE

    with pytest.raises(
        InputError, match="got No such file or directory; expected a readable"
    ):
        load_certificate(path)

    path.write_bytes(content)

    with pytest.raises(InputError, match=r"certificate\.json"):
        load_certificate(path)
