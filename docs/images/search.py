"""Draw ``search.svg``, the figure of docs/method.md: python docs/images/search.py."""

from html import escape
from pathlib import Path

WIDTH = 960
HEIGHT = 400
BOX_WIDTH = 168
BOX_HEIGHT = 64
STEP = 192  # from one rung to the next
RUNG_TOP = 24
TREE_TOP = 190
RUNGS = (
    ("Presolve", "fewer poses and windows"),
    ("Greedy and swaps", "raise the incumbent"),
    ("Lagrangian bound", "lowers the bound"),
    ("Walk", "finds all sets that tie"),
    ("HiGHS", "what is still open"),
)
LEAVES = (
    ("class 1", "sets that remain: valued"),
    ("class 2", "gains too small: cut"),
    ("none of them", "the run is lost; take the next"),
)


def text(x: float, y: float, words: str, *, bold: bool = False) -> str:
    """Element of a line of text, centred at x."""
    weight = ' font-weight="bold"' if bold else ""
    return f'<text x="{x}" y="{y}"{weight}>{escape(words)}</text>'


def box(x: float, y: float, title: str, words: str, *, width: int = BOX_WIDTH) -> str:
    """Elements of a box with its upper left corner at (x, y)."""
    middle = x + width / 2
    outline = (
        f'<rect x="{x}" y="{y}" width="{width}" height="{BOX_HEIGHT}" rx="6" '
        'fill="#fff" stroke="#222"/>'
    )
    return "\n".join(
        [
            outline,
            text(middle, y + 27, title, bold=True),
            text(middle, y + 47, words),
        ]
    )


def arrow(x_from: float, y_from: float, x_to: float, y_to: float) -> str:
    """Element of an arrow."""
    return (
        f'<line x1="{x_from}" y1="{y_from}" x2="{x_to}" y2="{y_to}" '
        'stroke="#222" marker-end="url(#a)"/>'
    )


def search_figure() -> str:
    """The rungs of a stage above, a node of the walk below."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        'font-family="DejaVu Sans, Arial, sans-serif" font-size="12" fill="#111" '
        'text-anchor="middle" role="img" aria-label="Rungs of the search">',
        '<defs><marker id="a" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" '
        'markerHeight="8" orient="auto"><path d="M0 0L10 5L0 10z" fill="#222"/>'
        "</marker></defs>",
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>',
    ]
    for number, (title, words) in enumerate(RUNGS):
        left = 12 + number * STEP
        parts.append(box(left, RUNG_TOP, title, words))
        if number:
            middle = RUNG_TOP + BOX_HEIGHT / 2
            parts.append(arrow(left - STEP + BOX_WIDTH, middle, left, middle))
    line = "Once incumbent and bound meet, the stage is proven and the next one begins"
    parts.append(text(WIDTH / 2, RUNG_TOP + BOX_HEIGHT + 32, line))
    root_left = (WIDTH - 2 * BOX_WIDTH) / 2
    node = box(
        root_left,
        TREE_TOP,
        "A node of the walk",
        "the run that fewest classes of poses cover",
        width=2 * BOX_WIDTH,
    )
    parts.append(node)
    leaf_width = 240
    for number, (title, words) in enumerate(LEAVES):
        left = 60 + number * 300
        parts.append(box(left, TREE_TOP + 130, title, words, width=leaf_width))
        foot = TREE_TOP + BOX_HEIGHT
        parts.append(arrow(WIDTH / 2, foot, left + leaf_width / 2, TREE_TOP + 130))
    return "\n".join([*parts, "</svg>", ""])


if __name__ == "__main__":
    Path(__file__).with_suffix(".svg").write_text(search_figure(), encoding="utf-8")
