"""The part of the report that answers to the reader: runs to play, a view to turn, tables to sort.

:func:`interactive_part` gives what ``templates/interactive.html.j2`` needs; everything that moves
is drawn by the scripts beside that template.
"""

from .part import interactive_part

__all__ = ["interactive_part"]
