"""The pages say what is so: commands parse, files exist, public names are described."""

import importlib
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from experiments.cli.main import cli
from geometry.catalogue import load_catalogue
from geometry.maps.site_files import read_sites
from placement.latency import load_latency_budget
from placement.sampling.uncertainty import load_uncertainty

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
API_PAGES = [DOCS / "api.rst"]
PACKAGES = ["geometry", "scenarios", "placement"]
_COMMAND = re.compile(r"^(?:\$ )?(?:uv run )?place-rsus (?=\S)(.*)$")
_INLINE = re.compile(r"`place-rsus ([^`]+)`")
_FILE = re.compile(
    r"(?:\.\./|docs/|results/|geometry/|scenarios/|placement/|experiments/|tests/)[\w./-]+\w"
)
# What the commands of the pages write, and what Sphinx does.
_WRITTEN = (
    "../gallery",
    "results/latest",
    "results/mine",
    "results/private",
    "results/both",
    "results/latency",
)


def _commands() -> Iterator[tuple[Path, str]]:
    for page in PAGES:
        fence = ""
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        for line in text.splitlines():
            if line.startswith("```"):
                fence = "" if fence else line.strip("`") or "text"
                continue
            if fence in ("sh", "console"):
                found = _COMMAND.match(line)
                if found and (fence == "sh" or line.startswith("$ ")):
                    yield page, found[1]
            elif not fence:
                for words in _INLINE.findall(line):
                    yield page, words


def _parse(words: list[str]) -> None:
    """Parse a command line with its subcommands, and run none of them; a name alone is enough."""
    command: click.Command = cli
    parent: click.Context | None = None
    name = "place-rsus"
    while words and words not in (["--help"], ["--help-all"]):
        context = command.make_context(name, words, parent=parent)
        rest = [*context._protected_args, *context.args]
        if not isinstance(command, click.Group) or not rest:
            return
        found_name, found, words = command.resolve_command(context, rest)
        assert found_name is not None
        assert found is not None
        name, command, parent = found_name, found, context


COMMANDS = sorted({(str(page.relative_to(ROOT)), words) for page, words in _commands()})


def test_pages_have_commands() -> None:
    assert len(COMMANDS) > 60


@pytest.mark.parametrize(("page", "words"), COMMANDS)
def test_commands_in_pages_parse(page: str, words: str) -> None:
    line = shlex.split(words.partition(" | ")[0].partition(" > ")[0], comments=True)
    _parse(line)


def test_an_option_that_does_not_exist_does_not_parse() -> None:
    with pytest.raises(click.NoSuchOption):
        _parse(["scene", "import", "a.osm", "--no-such-option"])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_named_in_pages_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    missing = [
        name
        for name in _FILE.findall(re.sub(r"https?://\S+", "", text))
        if not name.startswith(_WRITTEN)
        and not (ROOT / name).exists()
        and not (page.parent / name).exists()
    ]
    assert missing == []


def test_example_files_are_what_pages_say() -> None:
    files = DOCS / "files"
    assert list(load_catalogue(files / "cameras.toml")) == ["corner-4k"]
    assert load_latency_budget(str(files / "latency.toml")).worst_s == pytest.approx(0.072)
    uncertainty = load_uncertainty(str(files / "uncertainty.toml"))
    assert uncertainty.mounting.yaw_sd_deg == 2.0
    assert uncertainty.packet_loss == 0.0
    sites = read_sites(files / "poles.csv", crs="EPSG:25833")
    assert [site.id for site in sites if site.is_forbidden] == ["museum"]


@pytest.mark.parametrize("package", PACKAGES)
def test_public_names_are_in_the_api_pages(package: str) -> None:
    names = set(importlib.import_module(package).__all__)
    shown: set[str] = set()
    for page in API_PAGES:
        module = ""
        for line in page.read_text(encoding="utf-8").splitlines():
            if line.startswith(".. currentmodule:: "):
                module = line.split()[-1]
            elif module == package and (
                found := re.match(r"\.\. auto(?:class|function):: (\w+)$", line)
            ):
                shown.add(found[1])
    assert shown == names
