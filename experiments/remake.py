"""Results, and the figures that pages quote, made by their commands.

``python -m experiments.remake [--only NAME] [--check] [--limit SECONDS]``.

``results/remake.toml`` lists the files below ``results`` with the commands that write
them, and the figures of the pages with the commands that print them. Commands run in a
temporary folder, with the cache of the product.
"""

import difflib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

import click

from geometry.errors import InputError, refuse
from geometry.text_formats import load_toml, parse_json

ROOT = Path(__file__).parents[1]
LIST = ROOT / "results/remake.toml"
_FIGURE = r"-?[\d,]*\d(?:\.\d+)?"
_PLACEHOLDER = re.compile(r"\{(?P<pointer>/[^}*]*)(?:\*(?P<factor>\d+))?\}")
_WITH_COMMANDS = "console"
_SUMS = "SHA256SUMS"
# Pictures, hashes and packed tables depend on libraries.
_TEXTS = (".csv", ".geojson", ".json", ".md")
# Of results in JSON.
_VARYING = re.compile(r'"(seconds|versions|sha256)": (?:\{[^}]*\}|"[^"]*"|[\d.e-]+),?')
# Processors differ in the last digits.
_LONG_NUMBER = re.compile(r"\d+\.\d{7,}(?:e-\d+)?")
# A line of output that is less alike is not the quoted one.
_LEAST_ALIKE = 0.6


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Files below ``results``, and how they are made.

    Attributes
    ----------
    files : patterns of paths below ``results``.
    command : what writes them; "": people do.
    by_hand : why this module cannot run the command; "": it can.
    seconds : on two idle cores.
    leaves_out : files that the command writes and that are not kept.
    varies : whether the files depend on times, so that they differ each time.
    """

    name: str
    files: tuple[str, ...]
    command: str = ""
    by_hand: str = ""
    seconds: float = 0.0
    leaves_out: tuple[str, ...] = ()
    varies: bool = False

    def kept(self, root: Path) -> list[Path]:
        """Paths of its files, relative to a repository's root."""
        files = {
            path.relative_to(root)
            for pattern in self.files
            for path in root.glob(f"results/{pattern}")
        }
        return sorted(path for path in files if path.name not in self.leaves_out)


@dataclass(frozen=True, slots=True, kw_only=True)
class Quote:
    """Output and figures that a page quotes.

    Attributes
    ----------
    page : path from the repository's root.
    block : info string of the blocks that quote output: of "console" all, with their
        commands behind ``$``; of another one the first, which quotes `command`. "":
        none.
    command : what is run first; "": nothing.
    source : file that has the figures, written by the commands or of the repository.
    texts : sentences of the page with a placeholder ``{/pointer*factor}`` for each
        figure, see :func:`value_at`. Decimals are those that the page has.
    seconds : on two idle cores.
    """

    name: str
    page: str
    block: str = ""
    command: str = ""
    source: str = ""
    texts: tuple[str, ...] = ()
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class Stale:
    """A quoted piece of a page, (start, end) in its text, and what is computed."""

    start: int
    end: int
    computed: str


def load_list() -> tuple[list[Result], list[Quote], list[dict[str, Any]]]:
    """Results, quotes, and the figures of pages that are none of ours.

    Raises
    ------
    InputError
        The file is no TOML.
    """
    table = load_toml(LIST)
    results = [Result(**row) for row in table["results"]]
    return results, [Quote(**row) for row in table["quotes"]], table["given"]


def run(command: str, folder: Path) -> str:
    """Output of a command of the shell, run in a folder.

    Raises
    ------
    InputError
        It fails.
    """
    bin_folder = Path(sys.executable).parent
    path = f"{bin_folder}{os.pathsep}{os.environ['PATH']}"
    env = os.environ | {"PATH": path, "PYTHONPATH": str(ROOT), "ROOT": str(ROOT)}
    # A shell, for loops and redirections; -e, so that no failure is passed over.
    done = subprocess.run(
        ["bash", "-ec", command], cwd=folder, env=env, capture_output=True, text=True
    )
    if done.returncode:
        last = (done.stderr.strip().splitlines() or [""])[-1]
        refuse(command, f"exit code {done.returncode}: {last}", "exit code 0")
    return done.stdout


def spans(quote: Quote, text: str) -> list[tuple[int, int]]:
    """(start, end) of what a page quotes: blocks of output, then figures of sentences.

    Raises
    ------
    InputError
        The page does not have it.
    """
    found = []
    if quote.block:
        pattern = rf"^```{quote.block}\n(.*?)^```$"
        blocks = re.finditer(pattern, text, re.MULTILINE | re.DOTALL)
        found = [match.span(1) for match in blocks]
        if quote.block != _WITH_COMMANDS:
            found = found[:1]
    for sentence in quote.texts:
        # Between the words stand pointer and factor of each figure.
        words = [re.escape(word) for word in _PLACEHOLDER.split(sentence)[::3]]
        # Lines may break at any space.
        pattern = re.sub(r"(?:\\ )+", r"\\s+", f"({_FIGURE})".join(words))
        match = re.search(pattern, text)
        if match is None:
            refuse(quote.page, "no such text", sentence)
        found.extend(match.span(n + 1) for n in range(match.re.groups))
    return found


def stale_pieces(
    quote: Quote, text: str, folder: Path, output: Callable[[str], str]
) -> list[Stale]:
    """What a page quotes and is computed otherwise.

    Parameters
    ----------
    text : str
        Of the page.
    folder : Path
        Where commands run.
    output : callable
        Runs a command, and gives what it prints.

    Raises
    ------
    InputError
        A command fails, or the page quotes what there is not.
    """
    places = spans(quote, text)
    quoted = [text[start:end] for start, end in places]
    printed = ""
    if quote.command:
        printed = output(quote.command)
    computed: list[str] = []
    if quote.block == _WITH_COMMANDS:
        n_figures = sum(len(_PLACEHOLDER.findall(words)) for words in quote.texts)
        blocks = quoted[: len(quoted) - n_figures]
        computed.extend(_console_again(block, output, quote.page) for block in blocks)
    elif quote.block:
        computed.append(quoted_again(quoted[0], printed, quote.page))
    for placeholder in _PLACEHOLDER.finditer(" ".join(quote.texts)):
        # What a command has just written goes before what the repository has.
        source = folder / quote.source
        if not source.exists():
            source = ROOT / quote.source
        value = value_at(source.read_text(encoding="utf-8"), placeholder["pointer"])
        scaled = value * int(placeholder["factor"] or 1)
        computed.append(written(scaled, quoted[len(computed)]))
    return [
        Stale(start, end, now)
        for (start, end), now in zip(places, computed, strict=True)
        if now != text[start:end]
    ]


def _console_again(block: str, output: Callable[[str], str], page: str) -> str:
    """A block of commands behind ``$``, each with the output that it has now."""
    pieces = re.split(r"^(\$ .*\n)", block, flags=re.MULTILINE)
    again = pieces[0]
    for command, quoted in zip(pieces[1::2], pieces[2::2], strict=True):
        printed = output(command.removeprefix("$ ").strip())
        again += command + quoted_again(quoted, printed, page)
    return again


def value_at(document: str, pointer: str) -> float:
    """Figure of a JSON document at a pointer (RFC 6901), or behind words of a text.

    Raises
    ------
    InputError
        There is nothing.

    Examples
    --------
    >>> value_at('{"rows": [{"apr": 0.5}]}', "/rows/0/apr")
    0.5
    >>> value_at("| APR | 94.5 % |", "/APR |")
    94.5
    """
    try:
        if not document.startswith("{"):
            behind = document.partition(pointer[1:])[2]
            return float(re.findall(_FIGURE, behind)[0].replace(",", ""))
        value = parse_json(document, "source of figures", "JSON")
        for step in pointer.split("/")[1:]:
            if isinstance(value, list):
                value = value[int(step)]
            else:
                value = value[step]
        return float(value)
    except (KeyError, IndexError, TypeError, ValueError):
        raise InputError(
            "source of figures", f"nothing at {pointer}", "a figure"
        ) from None


def written(value: float, figure: str) -> str:
    """Write a value as a page has its figure: decimals, and commas of thousands.

    Examples
    --------
    >>> written(94.46, "93.0"), written(33388.0, "33,000")
    ('94.5', '33,388')
    """
    n_decimals = len(figure.partition(".")[2])
    if "," in figure:
        return f"{value:,.{n_decimals}f}"
    return f"{value:.{n_decimals}f}"


def quoted_again(block: str, output: str, where: str) -> str:
    r"""Lines of output in place of those that a block quotes, gaps ``...`` as they are.

    Each piece between gaps begins and ends with the lines of the output, behind the
    piece before it, that are most like its own.

    Raises
    ------
    InputError
        The output has no line that is like the quoted one.

    Examples
    --------
    >>> quoted_again("APR 93 %\n...\n", "Scene\nAPR 94 %\nProven\n", "page")
    'APR 94 %\n...\n'
    """
    lines = [line.rstrip() for line in output.splitlines()]
    again: list[str] = []
    piece: list[str] = []
    first = 0
    # A gap at the end closes the last piece.
    for line in [*block.splitlines(), "..."]:
        if line.strip() != "...":
            piece.append(line)
            continue
        if piece:
            start = _most_alike(piece[0], lines, first, where)
            end = start + 1
            if len(piece) > 1:
                end = _most_alike(piece[-1], lines, end, where) + 1
            again.extend(lines[start:end])
            first = end
            piece = []
        again.append(line)
    return "".join(f"{line}\n" for line in again[:-1])


def _most_alike(line: str, lines: Sequence[str], first: int, where: str) -> int:
    """Index of the line, from `first` on, that is most like a quoted one."""
    likeness = [
        difflib.SequenceMatcher(None, line, other, autojunk=False).ratio()
        for other in lines[first:]
    ]
    best = max(likeness, default=0.0)
    if best < _LEAST_ALIKE:
        refuse(where, f"{line!r}", "a line that the command prints")
    return first + likeness.index(best)


def _make(result: Result, *, is_check: bool) -> Iterator[str]:
    """Write a result's files; of a check, what differs."""
    with tempfile.TemporaryDirectory() as name:
        folder = _workplace(name)
        run(result.command, folder)
        _forget_sums(folder, result)
        made = result.kept(folder)
        # Files of the repository that nothing writes any more are told, too.
        for path in sorted({*made, *result.kept(ROOT)}):
            if path not in made:
                yield f"{path}: the command does not write it"
            elif not is_check:
                (ROOT / path).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(folder / path, ROOT / path)
            elif not result.varies:
                yield from _unlike(path, folder)


def _workplace(name: str) -> Path:
    """A folder with what commands read of the repository."""
    folder = Path(name)
    (folder / "docs").symlink_to(ROOT / "docs")
    (folder / "results").mkdir()
    return folder


def _forget_sums(folder: Path, result: Result) -> None:
    """Take files that are not kept out of the lists of hashes."""
    for sums in folder.rglob(_SUMS):
        lines = sums.read_text().splitlines(keepends=True)
        sums.write_text(
            "".join(line for line in lines if line.split()[-1] not in result.leaves_out)
        )


def _unlike(path: Path, folder: Path) -> Iterator[str]:
    """The first line in which a file differs from what is computed."""
    if not (ROOT / path).exists():
        yield f"{path}: is missing"
    elif path.suffix in _TEXTS:
        lines = _comparable_lines(ROOT / path)
        computed = _comparable_lines(folder / path)
        pairs = enumerate(zip_longest(lines, computed, fillvalue=""), 1)
        for number, (line, now) in pairs:
            if line != now:
                there = f"there is {line.strip()!r}"
                yield f"{path}:{number}: {there}; computed {now.strip()!r}"
                return


def _comparable_lines(path: Path) -> list[str]:
    """Lines of a text; of JSON, times, versions and hashes are blank."""
    text = path.read_text(encoding="utf-8")
    # Line breaks stay, so that numbers of lines do.
    if path.suffix == ".json":
        text = _VARYING.sub(lambda found: "\n" * found[0].count("\n"), text)
    return _LONG_NUMBER.sub(lambda found: f"{float(found[0]):.6g}", text).splitlines()


def _quote(quote: Quote, *, is_check: bool) -> Iterator[str]:
    """Rewrite what a page quotes; of a check, what differs."""
    page = ROOT / quote.page
    text = page.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as name:
        folder = _workplace(name)
        found = stale_pieces(quote, text, folder, partial(run, folder=folder))
    if is_check:
        for stale in found:
            yield from _unlike_lines(quote.page, text, stale)
        return
    # From the end, so that the places before it stay where they are.
    for stale in sorted(found, key=lambda each: -each.start):
        text = text[: stale.start] + stale.computed + text[stale.end :]
    if found:
        page.write_text(text, encoding="utf-8")


def _unlike_lines(page: str, text: str, stale: Stale) -> Iterator[str]:
    number = text.count("\n", 0, stale.start) + 1
    old = text[stale.start : stale.end].splitlines()
    new = stale.computed.splitlines()
    # Blocks may have lines more or fewer: only those that differ are told.
    matcher = difflib.SequenceMatcher(None, old, new, autojunk=False)
    for tag, start, end, new_start, new_end in matcher.get_opcodes():
        if tag != "equal":
            there = " / ".join(old[start:end])
            computed = " / ".join(new[new_start:new_end])
            yield f"{page}:{number + start}: there is {there!r}; computed {computed!r}"


@click.command()
@click.option("--only", "names", multiple=True, help="What of the list; repeat it.")
@click.option("--check", "is_check", is_flag=True, help="Compare, and write nothing.")
@click.option("--limit", "limit_s", type=float, help="Leave out what takes longer. [s]")
def main(names: tuple[str, ...], is_check: bool, limit_s: float | None) -> None:
    """Make results and quoted figures anew; exit code 2 if a --check finds others."""
    results, quotes, _ = load_list()
    # Results first: pages quote them.
    rows: list[Result | Quote] = [*results, *quotes]
    unknown = {*names} - {row.name for row in rows}
    if unknown:
        raise click.UsageError(f"--only {min(unknown)}: not in {LIST.name}")
    is_alike = True
    for row in rows:
        if names and row.name not in names:
            continue
        if limit_s is not None and row.seconds > limit_s:
            continue
        if isinstance(row, Result) and row.by_hand:
            click.echo(f"{row.name}: by hand: {row.by_hand}")
            continue
        try:
            told = list(_remake(row, is_check=is_check))
        except InputError as error:
            told = [str(error)]
        is_alike = is_alike and not told
        click.echo("\n".join(told or [f"{row.name}: done"]))
    if not is_alike:
        sys.exit(2)


def _remake(row: Result | Quote, *, is_check: bool) -> Iterator[str]:
    if isinstance(row, Quote):
        return _quote(row, is_check=is_check)
    return _make(row, is_check=is_check)


if __name__ == "__main__":
    main()
