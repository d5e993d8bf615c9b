"""What was assumed of a map: in sentences, a box of the report, lines on the
terminal.
"""

from types import SimpleNamespace

from experiments.cli.answers import assumption_parts
from experiments.cli.terminal import answer_text
from experiments.language import speaking
from experiments.parts.assumptions import _figures, assumption_sentences
from experiments.report.page import page_template
from geometry.notes import Note
from geometry.phrases import Phrase
from placement.detectors import load_detector


def moved(site_id, away_m):
    """A note on a sign that was moved."""
    why = Phrase(
        "it stood on a lane or in the junction: moved {away:.1f} m to the nearest kerb",
        away=away_m,
    )
    what = Phrase("{kind} {name}", kind=Phrase("sign"), name=site_id)
    return Note(
        kind="sites",
        what=what,
        why=why,
        site_ids=(site_id,),
    )


def result(*notes):
    return SimpleNamespace(assumptions=notes)


def test_sites_of_which_the_same_is_assumed_share_a_sentence():
    notes = [moved(f"n{i}", away_m) for i, away_m in enumerate((12.5, 3.0, 16.8, 4.0))]
    assert assumption_sentences(result(*notes)) == [
        "4 sites (n0, n1, n2 and 1 more): it stood on a lane or in the junction: moved"
        " 3 to 16.8 m to the nearest kerb."
    ]
    assert assumption_sentences(result(notes[0])) == [
        "sign n0: it stood on a lane or in the junction: moved 12.5 m to the nearest"
        " kerb."
    ]

    with speaking("de"):
        (text,) = assumption_sentences(result(*notes))
        assert "3 bis 16,8 m" in text


def test_the_terminal_tells_the_first_few_and_counts_the_others():
    notes = [Note(kind="roads", what=f"road {i}", why="straight on") for i in range(6)]
    parts = assumption_parts(result(*notes))
    assert answer_text(parts, is_verbose=False) == "6 details of the map are assumed."

    lines = answer_text(parts, is_verbose=True).splitlines()[2:]
    assert lines[0] == "Assumed because the map does not give it:"
    assert lines[1:5] == [f"  road {i}: straight on." for i in range(4)]
    assert lines[5] == "  and 2 more: in the report and `scene show`"
    assert not any(assumption_parts(result()))


def test_the_page_has_a_box_where_something_is_assumed():
    def page(assumed):
        return page_template().render(
            title="t",
            answer=["a"],
            assumed=assumed,
            sections=[],
            interactive={"n_runs": 0, "n_all": 0, "player_json": "{}"},
            details=[],
        )

    text = page([f"<{i}> is assumed." for i in range(7)])
    head = text.split("</header>")[0]

    assert head.count("is assumed.") == 7
    assert "&lt;0&gt; is assumed." in head
    assert "and 2 more" in head
    assert "<aside" not in page([])


def test_the_report_counts_the_measured_figures_of_response_tables():
    response = load_detector("response")
    table = load_detector("cnn-table")
    figures = _figures(SimpleNamespace(detector=response, table_detector=response))

    assert figures == [response.figures_words]

    # A network's own table stands in for it; boxes alone have no such figures.
    network = SimpleNamespace(name="cnn", figures_words=None)
    (told,) = _figures(SimpleNamespace(detector=network, table_detector=table))
    assert told.startswith(
        "11 of the 14 values of cnn-table are measured; assumed: motorcyclist"
    )

    rule = load_detector()
    assert _figures(SimpleNamespace(detector=rule, table_detector=rule)) == []
