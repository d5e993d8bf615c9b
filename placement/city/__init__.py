"""Many junctions under one budget.

Junctions are independent given their budgets. ``junction`` finds the front of one: what each
number of units, and each sum of money, buys there, with bounds; ``fronts`` holds it. ``knapsack``
takes one point of each front so that the sum is best; ``choose`` asks it objective by objective,
within a city's wishes; ``phases`` spreads what was chosen over years.
"""
