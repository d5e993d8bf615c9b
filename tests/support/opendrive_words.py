"""Lanes and cubics of OpenDRIVE in few words."""

from opendrive_text import cubic, lane, section


def cubics(tag, text):
    """Cubics of a text such as "0 3, 50 3 0.02": where each begins, and a, b, c, d."""
    return "".join(cubic(tag, *map(float, part.split())) for part in text.split(", "))


def section_of(text, **about):
    """A section with lanes such as "1 driving, -1 sidewalk width=2 after=-2".

    Lanes are driving ones, 3.5 m wide, unless told otherwise. `before` and `after` are
    their numbers in the sections around.
    """
    sides = {"left": [], "right": []}
    for part in text.split(", "):
        number, *words = part.split()
        told = {}
        kind = "driving"
        for word in words:
            key, equals, value = word.partition("=")
            if not equals:
                kind = word
            elif key == "width":
                told[key] = float(value)
            else:
                told[key] = int(value)

        side = "left" if int(number) > 0 else "right"
        sides[side].append(lane(int(number), kind, **told))
    return section(**sides, **about)
