"""Perception lab: datasets, fitted response tables, a trained network.

``commands`` has ``place-rsus dataset``, ``detector`` and ``render``; ``training`` makes
the network that is shipped.
"""
