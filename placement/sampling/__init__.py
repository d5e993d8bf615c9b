"""Uncertainty -> sampled worlds -> detection tables of many worlds.

``uncertainty`` says what is uncertain and how much; ``traffic`` parks vehicles and lets others
wait, out of the way of VUT and VRU; ``moving`` lets vehicles drive by; ``worlds`` draws worlds,
each thing with random numbers of its own, and ``tables`` their detection tables, with misses and
lost messages, end to end for the optimiser. ``out_of_sample`` evaluates a layout in worlds that it
was not chosen in.
"""
