"""The report as PDF, by a browser or by what stands in for one."""

import re
import shutil
import sys

import pytest
from command_results import refusal

from experiments.report.printing import find_browser, print_page
from geometry.errors import InputError

FEW = (
    "--budget",
    "1",
    "--cases",
    "CBLA",
    "--approaches",
    "east",
    "--along-arms",
    "0",
    "--quiet",
)


def browser(folder, body):
    path = folder / "chromium"
    path.write_text(f"#!{sys.executable}\nimport sys\n{body}")
    path.chmod(0o755)
    return path


def test_what_the_browser_prints_is_the_file(tmp_path):
    body = (
        "to = [a for a in sys.argv if a.startswith('--print-to-pdf=')][0].split('=',"
        " 1)[1]\nopen(to, 'w').write(sys.argv[-1])\n"
    )
    print_page(browser(tmp_path, body), tmp_path / "a page.html", tmp_path / "out.pdf")
    assert (tmp_path / "out.pdf").read_text() == (
        tmp_path / "a page.html"
    ).resolve().as_uri()


def test_a_browser_that_prints_nothing_is_told_and_nothing_is_lost(tmp_path):
    (tmp_path / "out.pdf").write_text("mine")
    with pytest.raises(InputError, match="no page printed"):
        print_page(browser(tmp_path, ""), tmp_path / "a.html", tmp_path / "out.pdf")
    assert (tmp_path / "out.pdf").read_text() == "mine"


def test_without_a_browser_nothing_is_computed(run, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert refusal(run(*FEW, "--pdf a.pdf")).startswith(
        "--pdf: got no browser that prints"
    )


def test_the_folder_of_results_has_nothing_but_results(run):
    code, _, err = run(*FEW, "--out there --pdf there/a.pdf")
    assert code == 2
    assert "outside of --out" in err


# Quickly: test_what_the_browser_prints_is_the_file
@pytest.mark.long
@pytest.mark.system
@pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is missing")
def test_a_report_has_at_most_twelve_pages(run, tmp_path):
    assert run(*FEW, "--out there --pdf a.pdf")[0] == 0
    content = (tmp_path / "work" / "a.pdf").read_bytes()
    assert content.startswith(b"%PDF")
    assert 1 <= len(re.findall(rb"/Type\s*/Page[^s]", content)) <= 12
    assert find_browser().name.startswith("chromium")
