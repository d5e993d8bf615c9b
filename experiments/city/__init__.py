"""``place-rsus city``: a program that chooses units for all junctions of a city."""
