"""Density of the code: the figures that keep it readable stay within their limits."""

import ast
import io
import subprocess
import tokenize
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("geometry", "scenarios", "placement", "experiments")
NOT_COUNTED = {
    tokenize.COMMENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
    tokenize.INDENT,
    tokenize.NEWLINE,
    tokenize.NL,
}


@dataclass
class Figures:
    """Counts over files of Python."""

    lines: int = 0
    tokens: int = 0
    docstring_lines: int = 0
    comment_lines: int = 0
    paired_assignments: int = 0
    conditional_expressions: int = 0
    packed_calls: int = 0


def count(texts):
    """Add up the figures of texts."""
    figures = Figures()
    for text in texts:
        docstring_lines = count_syntax(ast.parse(text), figures)
        lines = text.splitlines()
        figures.lines += len(lines)
        figures.docstring_lines += len(docstring_lines)
        figures.comment_lines += sum(
            line.lstrip().startswith("#")
            for number, line in enumerate(lines, 1)
            if number not in docstring_lines
        )
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        figures.tokens += sum(token.type not in NOT_COUNTED for token in tokens)
    return figures


def count_syntax(tree, figures):
    """Count what the syntax tree shows; return the numbers of docstrings' lines."""
    docstring_lines = set()
    for node in ast.walk(tree):
        match node:
            case (
                ast.Module(
                    body=[ast.Expr(value=ast.Constant(value=str())) as first, *_]
                )
                | ast.ClassDef(
                    body=[ast.Expr(value=ast.Constant(value=str())) as first, *_]
                )
                | ast.FunctionDef(
                    body=[ast.Expr(value=ast.Constant(value=str())) as first, *_]
                )
            ):
                docstring_lines.update(range(first.lineno, first.end_lineno + 1))
            case ast.Assign(targets=[ast.Tuple(), *_], value=ast.Tuple()):
                figures.paired_assignments += 1
            case ast.IfExp():
                figures.conditional_expressions += 1
            case ast.Call(args=arguments):
                figures.packed_calls += any(is_packed(one) for one in arguments)
    return docstring_lines


def is_packed(argument):
    """Is an argument a starred sequence, written out in the call itself?"""
    if not isinstance(argument, ast.Starred):
        return False
    return isinstance(argument.value, ast.Tuple | ast.List)


def read(*folders):
    """Texts of the files that git tracks in folders."""
    patterns = [f"{folder}/*.py" for folder in folders]
    listed = subprocess.run(
        [
            "git",
            "ls-files",
            "-z",
            "--cached",
            "--others",
            "--exclude-standard",
            *patterns,
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if listed.returncode:
        pytest.skip("needs a checkout of git")
    names = [name for name in listed.stdout.split("\0") if name]
    paths = [ROOT / name for name in names]
    return [path.read_text() for path in paths if path.exists()]


def test_counting_sees_each_kind_of_packing():
    text = '"""Doc."""\n# why\na, b = 1, 2\nf(*(a, b), 1 if a else 2)\n'
    figures = count([text])

    assert figures.lines == 4
    assert figures.docstring_lines == 1
    assert figures.comment_lines == 1
    assert figures.paired_assignments == 1
    assert figures.conditional_expressions == 1
    assert figures.packed_calls == 1
    assert figures.tokens == 23


@pytest.mark.long
def test_product_stays_readable():
    figures = count(read(*PACKAGES))
    assert figures.tokens / figures.lines <= 5.5
    assert figures.docstring_lines / figures.lines >= 0.17
    assert figures.comment_lines / figures.lines >= 0.025
    assert 1000 * figures.paired_assignments / figures.lines <= 1.0
    assert 1000 * figures.conditional_expressions / figures.lines <= 6.0
    assert figures.packed_calls == 0


@pytest.mark.long
def test_tests_stay_readable():
    figures = count(read("tests"))
    assert figures.tokens / figures.lines <= 6.0
    assert 1000 * figures.paired_assignments / figures.lines <= 1.0
    assert 1000 * figures.conditional_expressions / figures.lines <= 6.0
    assert figures.packed_calls == 0
