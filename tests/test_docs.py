"""The pages say what is so: commands parse, files exist, public names are described."""

import ast
import importlib
import io
import re
import shlex
import tokenize
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path

import click
import pytest

from experiments.main import cli
from geometry.catalogue import load_catalogue
from geometry.maps.place_lists import read_sites
from placement.latency import load_latency_budget
from placement.sampling.uncertainty import load_uncertainty

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
ROOT_PAGES = [
    ROOT / name
    for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")
]
PAGES = [*ROOT_PAGES, *sorted(DOCS.rglob("*.md"))]
RESULT_PAGES = sorted((ROOT / "results").rglob("*.md"))
API_PAGES = [DOCS / "api.rst"]
PACKAGES = ["geometry", "scenarios", "placement"]
FOLDERS = [*PACKAGES, "experiments", "tests"]
_COMMAND = re.compile(r"^(?:\$ )?(?:uv run )?place-rsus (?=\S)(.*)$")
_INLINE = re.compile(r"`place-rsus ([^`]+)`")
_FILE = re.compile(
    r"(?<![\w/.-])(?:\.\./|\.ci/|docs/|results/|geometry/|scenarios/|placement/|experiments/|tests/|data/)"
    r"[\w./-]*\w"
)
_BARE_FILE = re.compile(r"(?<![\w/.-])[a-z]\w*\.(?:py|md)\b")
_MODULE = re.compile(
    r"(?<![\w/.-])(?:geometry|scenarios|placement|experiments)(?:\.[A-Za-z_]\w*)+"
)
# `placement/latency_curves.py` (`apr_by_latency`): a file or folder, and names of
# what is in it.
_NAMES_IN_FILE = re.compile(r"`([\w/]+(?:\.py|/))` \(((?:`\w+`(?:, )?)+)\)")
_OPTION = re.compile(r"(?<![\w-])--[a-z][a-z0-9-]*")
# SUMO's, and the benchmark's.
_OPTIONS_OF_OTHERS = {"--parts", "--hours", "--mean-only", "--no-dashboard"}
# In the CarlaNCAP study's release; in a-b-street/osm2streets.
_FILES_OF_OTHERS = ("ncap.py", "tests/src/neukolln/input.osm")
# What the commands of the pages write, and what Sphinx does.
_WRITTEN = (
    "results/budget-3/report.html",
    "results/renders/rsu3-WEATHER",
    "results/renders/vut-WEATHER",
    "../gallery",
    "results/latest",
    "results/mine",
    "results/private",
    "results/both",
    "results/latency",
)


def _text_of(file: Path) -> str:
    """Text of a file; of the changelog only what is new and still there."""
    text = file.read_text()
    if file.name != "CHANGELOG.md":
        return text
    return text.split("\n## ")[1].split("### Removed")[0]


def _commands() -> Iterator[tuple[Path, str]]:
    """Page and words of each command line in the pages."""
    for page in PAGES:
        fence = ""
        text = _text_of(page).replace("\\\n", " ")
        for line in text.splitlines():
            if line.startswith("```"):
                if fence:
                    fence = ""
                else:
                    fence = line.strip("`") or "text"
                continue
            if fence in ("sh", "console"):
                found = _COMMAND.match(line)
                if found and (fence == "sh" or line.startswith("$ ")):
                    yield page, found[1]
            elif not fence:
                for words in _INLINE.findall(line):
                    yield page, words


def _parse(words: list[str]) -> None:
    """Parse a command line with its subcommands, and run none of them; a name alone is
    enough.
    """
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
        name = found_name
        command = found
        parent = context


COMMANDS = sorted({(str(page.relative_to(ROOT)), words) for page, words in _commands()})


def test_pages_have_commands():
    assert len(COMMANDS) > 60


@pytest.mark.parametrize(("page", "words"), COMMANDS)
def test_commands_in_pages_parse(page, words):
    line = shlex.split(words.partition(" | ")[0].partition(" > ")[0], comments=True)
    _parse(line)


def test_an_option_that_does_not_exist_does_not_parse():
    with pytest.raises(click.NoSuchOption):
        _parse(["scene", "import", "a.osm", "--no-such-option"])


def _missing_files(text: str, page: Path) -> list[str]:
    """Paths in a text that lead nowhere, neither from the root nor from a folder above
    the page.
    """
    folders = [
        ROOT,
        *(folder for folder in page.parents if folder.is_relative_to(ROOT)),
    ]
    return [
        name
        for name in _FILE.findall(re.sub(r"https?://\S+", "", text))
        if not name.startswith((*_WRITTEN, *_FILES_OF_OTHERS))
        and not any((above / name).exists() for above in folders)
    ]


def _missing_modules(text: str) -> list[str]:
    """Dotted names below the packages that name neither a module nor a name in one."""
    missing = []
    for name in _MODULE.findall(text):
        place = ROOT
        parts = name.split(".")
        while parts and (place / parts[0]).is_dir():
            place /= parts.pop(0)
        if parts and (place / f"{parts[0]}.py").is_file():
            place /= f"{parts.pop(0)}.py"
        if parts and not _is_named_in(place, parts[0]):
            missing.append(name)
    return missing


def _is_named_in(place: Path, name: str) -> bool:
    """Does a module or package have a name? Packages list theirs in ``__init__.pyi`` or
    ``.py``.
    """
    if place.is_file():
        files = [place]
    else:
        files = place.glob("__init__.py*")
    return any(re.search(rf"\b{name}\b", _text_of(file)) for file in files)


def _page_id(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", [*PAGES, *RESULT_PAGES], ids=_page_id)
def test_files_named_in_pages_exist(page):
    assert _missing_files(_text_of(page), page) == []


@pytest.mark.parametrize("page", PAGES, ids=_page_id)
def test_modules_named_in_pages_exist(page):
    assert _missing_modules(_text_of(page)) == []


@pytest.mark.parametrize("page", PAGES, ids=_page_id)
def test_files_named_alone_are_in_the_folder_named_before_them(page):
    missing = []
    for paragraph in _text_of(page).split("\n\n"):
        folder = ROOT
        for name in re.findall(r"`([a-z][\w./-]*(?:\.py|/))`", paragraph):
            if "/" in name:
                if name.endswith(".py"):
                    folder = (ROOT / name).parent
                else:
                    folder = ROOT / name
            elif not any(folder.rglob(name)):
                missing.append(name)
    assert missing == []


@pytest.mark.parametrize("page", PAGES, ids=_page_id)
def test_names_in_brackets_behind_a_file_are_in_it(page):
    missing = []
    for place, names in _NAMES_IN_FILE.findall(_text_of(page)):
        for name in re.findall(r"\w+", names):
            if place.endswith(".py"):
                found = re.search(rf"\b{name}\b", _text_of(ROOT / place)) is not None
            else:
                found = (ROOT / place / name).exists() or (
                    ROOT / place / f"{name}.py"
                ).exists()
            if not found:
                missing.append(f"{place}: {name}")
    assert missing == []


def _options(command: click.Command) -> Iterator[str]:
    """Options of a command and of those below it."""
    for parameter in command.params:
        yield from (*parameter.opts, *parameter.secondary_opts)
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            inner = command.get_command(context, name)
            assert inner is not None
            yield from _options(inner)


def test_options_named_in_pages_exist():
    known = {*_options(cli), "--help", *_OPTIONS_OF_OTHERS}
    missing = {
        f"{_page_id(page)}: {option}"
        for page in [*PAGES, *RESULT_PAGES]
        for line in re.sub(
            r"```.*?```", "", _text_of(page), flags=re.DOTALL
        ).splitlines()
        for words in re.findall(r"`([^`]+)`", line)
        if not re.search(r"\b(?:uv|pytest|python) ", words)
        for option in _OPTION.findall(words)
        if option not in known
    }
    assert missing == set()


def _prose(text: str) -> Iterator[str]:
    """Docstrings and comments of a module."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(
            node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
        ):
            yield ast.get_docstring(node, clean=False) or ""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.string


def _missing_in_module(file: Path, known_names: Iterable[str]) -> list[str]:
    """What a module's prose names and is not there."""

    def missing(text: str) -> list[str]:
        text = text.replace("../", "")  # in code these are names of users' files
        alone = set(_BARE_FILE.findall(text)).difference(known_names)
        return [*_missing_files(text, file), *_missing_modules(text), *sorted(alone)]

    text = _text_of(file)
    # Parsing all modules would take ten seconds: only those where something is missing
    # anywhere.
    if missing(text):
        return [name for prose in _prose(text) for name in missing(prose)]
    return []


@pytest.mark.long
@pytest.mark.parametrize("folder", FOLDERS)
def test_files_and_modules_named_in_docstrings_and_comments_exist(folder):
    known = {
        file.name
        for inner in (*FOLDERS, "docs", "results")
        for file in (ROOT / inner).rglob("*")
    }
    known |= {*(page.name for page in ROOT_PAGES), *_FILES_OF_OTHERS}
    missing = {
        f"{_page_id(file)}: {name}"
        for file in sorted((ROOT / folder).rglob("*.py"))
        for name in _missing_in_module(file, known)
    }

    assert missing == set()


def test_example_files_are_what_pages_say():
    files = DOCS / "files"
    assert list(load_catalogue(files / "cameras.toml")) == ["corner-4k"]
    assert load_latency_budget(str(files / "latency.toml")).worst_s == pytest.approx(
        0.072
    )

    uncertainty = load_uncertainty(str(files / "uncertainty.toml"))
    assert uncertainty.mounting.yaw_sd_deg == 2.0
    assert uncertainty.packet_loss == 0.0

    sites = read_sites(files / "poles.csv", crs="EPSG:25833")
    assert [site.id for site in sites if site.is_forbidden] == ["museum"]


@pytest.mark.parametrize("package", PACKAGES)
def test_public_names_are_in_the_api_pages(package):
    names = set(importlib.import_module(package).__all__)
    shown: set[str] = set()
    for page in API_PAGES:
        module = ""
        for line in page.read_text().splitlines():
            if line.startswith(".. currentmodule:: "):
                module = line.split()[-1]
            elif module == package and (
                found := re.match(r"\.\. auto(?:class|function):: (\w+)$", line)
            ):
                shown.add(found[1])

    assert shown == names


def test_version_is_one_in_all_places():
    project = tomllib.loads(_text_of(ROOT / "pyproject.toml"))["project"]
    version = project["version"]

    assert f"\nversion: {version}\n" in _text_of(ROOT / "CITATION.cff")
    assert f"version {version}, " in _text_of(ROOT / "README.md").replace("\n", " ")
    assert f"\n## {version}\n" in (ROOT / "CHANGELOG.md").read_text()
    assert f"\nplace-rsus {version}, Python " in _text_of(DOCS / "how_to/rays.md")
