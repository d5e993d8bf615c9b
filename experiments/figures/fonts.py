"""Fonts that have the letters of a name."""

from functools import cache


@cache
def families_for(text: str) -> tuple[str, ...] | None:
    """Font families that draw every letter of a text between them.

    Empty where the default font has all letters; the default and another one where
    this machine has a font with the others; None where it has none.
    """
    from matplotlib.font_manager import FontProperties, findfont, fontManager

    # matplotlib draws each letter with the first family that has it.
    default = FontProperties()
    missing = _letters(text) - _letters_of(findfont(default))
    if not missing:
        return ()
    for font in sorted(fontManager.ttflist, key=lambda one: (one.style, one.name)):
        # It comes with matplotlib and has a box for every letter.
        if font.name.startswith("Last Resort"):
            continue
        if missing <= _letters_of(font.fname):
            return (default.get_name(), font.name)
    return None


def _letters(text: str) -> frozenset[int]:
    """Code points of a text, without spaces."""
    return frozenset(ord(letter) for letter in text if not letter.isspace())


@cache
def _letters_of(path: str) -> frozenset[int]:
    """Code points that a font file has; none of a file that cannot be read."""
    from matplotlib.ft2font import FT2Font

    try:
        return frozenset(FT2Font(path).get_charmap())
    except (OSError, RuntimeError):
        return frozenset()
