"""Results and quoted figures are what commands give."""

import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from experiments import remake
from experiments.remake import Quote, Result, load_list, spans, stale_pieces

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
RESULTS, QUOTES, GIVEN = load_list()
# What a command may take here.
LIMIT_S = 200.0
PAGE = """# Page

```text
For cars:
prevent 94.0 %
...
proven
```

Three prevent 94.0 % of 1,000
collisions.
"""


def asked(*options):
    """Result of the command."""
    return CliRunner().invoke(remake.main, options)


def test_every_file_of_results_is_of_one_command_or_made_by_hand():
    kept = [path for result in RESULTS for path in result.kept(ROOT)]
    files = {
        path.relative_to(ROOT)
        for path in (ROOT / "results").rglob("*")
        if path.is_file() and "latest" not in path.parts
    }
    left_out = {name for result in RESULTS for name in result.leaves_out}

    assert len(kept) == len(set(kept))
    assert {path for path in files if path.name not in left_out} == set(kept)
    assert all(result.command or result.by_hand for result in RESULTS)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_percentage_of_a_page_is_checked_or_is_none_of_ours(page):
    name = page.relative_to(ROOT).as_posix()
    text = page.read_text()
    # Comments of commands.
    checked = [match.span() for match in re.finditer(r"(?ms)^```sh\n.*?^```", text)]
    for quote in QUOTES:
        if quote.page == name:
            checked += spans(quote, text)
    for given in GIVEN:
        if given["page"] == name:
            for words in given["texts"]:
                assert words in text
                start = text.index(words)
                checked.append((start, start + len(words)))
    missing = [
        f"{name}:{text.count(chr(10), 0, figure.start()) + 1}: {figure[0]}"
        for figure in re.finditer(r"\d[\d.]* %", text)
        if not any(start <= figure.start() < end for start, end in checked)
    ]

    assert missing == []


@pytest.mark.parametrize(
    "quote",
    [quote for quote in QUOTES if not quote.seconds],
    ids=lambda quote: quote.name,
)
def test_figures_that_pages_quote_from_results_are_theirs(quote):
    done = asked("--check", "--only", quote.name)
    assert done.exit_code == 0, done.output


@pytest.mark.long
@pytest.mark.parametrize(
    "row",
    [
        row
        for row in (*RESULTS, *QUOTES)
        if 0.0 < row.seconds <= LIMIT_S and not getattr(row, "varies", False)
    ],
    ids=lambda row: row.name,
)
def test_figures_and_results_are_what_their_commands_give(row):
    done = asked("--check", "--only", row.name)
    assert done.exit_code == 0, done.output


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A project with one page, one result, and commands that print lines."""
    monkeypatch.setattr(remake, "ROOT", tmp_path)
    (tmp_path / "docs").mkdir()
    (tmp_path / "results").mkdir()
    (tmp_path / "page.md").write_text(PAGE)
    write = (
        'printf \'{"apr": %s, "runs": 1000,\\n"seconds": %s}\' %s %s > results/apr.json'
    )
    quote = Quote(
        name="quote",
        page="page.md",
        block="text",
        command="printf 'Scene\\nFor cars:\\nprevent 94.5 %%\\nmore\\nproven\\n'",
        source="results/apr.json",
        texts=("prevent {/apr*100} % of {/runs} collisions",),
    )
    result = Result(
        name="apr",
        files=("*.json",),
        command=write.replace("%s > ", "$RANDOM > ").replace(" %s $R", " 0.945 $R"),
    )
    monkeypatch.setattr(remake, "load_list", lambda: ([result], [quote], []))
    return tmp_path


def test_a_check_names_file_and_line_of_what_differs_and_writes_nothing(project):
    (project / "results/apr.json").write_text(
        '{"apr": 0.94, "runs": 1000,\n"seconds": 3}'
    )
    done = asked("--check")

    assert done.exit_code == 2
    assert done.output.splitlines() == [
        'results/apr.json:1: there is \'{"apr": 0.94, "runs": 1000,\';'
        ' computed \'{"apr": 0.945, "runs": 1000,\'',
        "page.md:5: there is 'prevent 94.0 %'; computed 'prevent 94.5 %'",
    ]
    assert (project / "page.md").read_text() == PAGE


def test_results_and_pages_are_written_anew_and_agree_from_then_on(project):
    assert asked().exit_code == 0
    assert (project / "page.md").read_text() == PAGE.replace("94.0", "94.5")

    done = asked("--check")
    assert done.exit_code == 0, done.output


def test_what_has_gone_is_told(project):
    (project / "page.md").write_text(PAGE.replace("proven", "best of all"))
    done = asked("--check", "--only", "quote")

    assert done.exit_code == 2
    assert "page.md: got 'best of all'; expected a line" in done.output

    (project / "page.md").write_text(PAGE.replace("collisions", "accidents"))
    assert "page.md: got no such text" in asked("--check", "--only", "quote").output
    assert asked("--only", "quota").exit_code == 2


def test_a_command_that_fails_is_told(project, monkeypatch):
    broken = Result(name="broken", files=("x",), command="echo no disk >&2; exit 3")
    monkeypatch.setattr(remake, "load_list", lambda: ([broken], [], []))
    done = asked()

    assert done.exit_code == 2
    assert "got exit code 3: no disk" in done.output


def test_output_behind_each_command_of_a_page_is_compared(tmp_path):
    text = "```console\n$ a\n1 pole\n$ b\n...\n2 poles\n```\n"
    printed = {"a": "1 pole\n", "b": "scene\n3 poles\n"}
    quote = Quote(name="q", page="p.md", block="console")
    (found,) = stale_pieces(quote, text, tmp_path, printed.__getitem__)

    assert found.computed == "$ a\n1 pole\n$ b\n...\n3 poles\n"
