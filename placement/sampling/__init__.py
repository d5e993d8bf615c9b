"""Sampled worlds: what is uncertain, drawn many times.

The steps are: uncertainty -> sampled worlds -> detection tables of many worlds
-> layouts in other worlds.
"""
