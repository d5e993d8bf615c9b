"""The part of the report that answers to the reader: runs to play, a view to turn.

:func:`.part.interactive_part` gives what ``templates/interactive.html.j2`` needs; everything that
moves is drawn by the scripts beside that template.
"""
