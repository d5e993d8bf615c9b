"""Machine code of the local search with row weights and of the Lagrangian bound.

What changes stands in arrays that the caller keeps, so that a kernel can stop after some work and
go on when it is called again: its caller looks at clock and keyboard meanwhile. Work is counted in
entries of the matrix that were looked at.
"""

from typing import NamedTuple

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel


class Matrix(NamedTuple):
    """Which column covers which row, by columns and by rows, and what columns cost."""

    column_start: IntArray  # (n_columns + 1,): where the rows of each column start in `rows`
    rows: IntArray  # (n_entries,)
    row_start: IntArray  # (n_rows + 1,): where the columns of each row start in `columns`
    columns: IntArray  # (n_entries,)
    cost: FloatArray  # (n_columns,)


class State(NamedTuple):
    """Chosen columns and all that depends on them, and what the search remembers.

    A column that is not chosen scores the weights of the rows that it would cover in addition, one
    that is chosen those of the rows that nothing else covers: what its choice gains or would lose.
    """

    weight: IntArray  # (n_rows,): grows while a row stays uncovered
    times: IntArray  # (n_rows,): how many chosen columns cover a row
    # (n_rows,): exclusive or of the chosen columns that cover a row: the one, if it is one.
    holder: IntArray
    score: IntArray  # (n_columns,)
    changed: IntArray  # (n_columns,): step at which a column was last added or removed
    may_add: BoolArray  # (n_columns,): whether a score changed since a column was removed
    place: IntArray  # (n_columns,): where it stands in `chosen`, or -1
    chosen: IntArray  # (n_columns,): the first N_CHOSEN count
    uncovered_place: IntArray  # (n_rows,): where it stands in `uncovered`, or -1
    uncovered: IntArray  # (n_rows,): the first N_UNCOVERED count
    counters: IntArray  # (5,)


N_CHOSEN, N_UNCOVERED, TABU, STEP, CHANCE = range(5)
"""Counters: columns chosen, rows uncovered, column added last, steps made, state of chance."""


@kernel
def complete_greedily(matrix: Matrix, state: State, work: int) -> int:
    """Add what covers most weight for its cost until all rows are covered, or the work is done.

    Returns how much of the work is left.
    """
    cost, score = matrix.cost, state.score
    while state.counters[N_UNCOVERED] > 0 and work > 0:
        best = -1
        for column in range(len(cost)):
            if (
                state.place[column] < 0
                and score[column] > 0
                and (best < 0 or score[column] * cost[best] > score[best] * cost[column])
            ):
                best = column
        work -= len(cost) + _add(matrix, state, best)
    return int(max(work, 0))


@kernel
def search_cheaper(matrix: Matrix, state: State, limit: float, work: int) -> int:
    """Exchange columns until those chosen cover all rows for less than `limit`.

    Returns how much of the work is left; nothing if they do not.
    """
    cost, counters = matrix.cost, state.counters
    spent = 0.0
    for nth in range(counters[N_CHOSEN]):
        spent += cost[state.chosen[nth]]
    while work > 0:
        if counters[N_UNCOVERED] == 0:
            if spent < limit:
                return int(work)
            out = _least_missed(matrix, state, -1)
            spent -= cost[out]
            work -= counters[N_CHOSEN] + _remove(matrix, state, out)
            continue
        out = _least_missed(matrix, state, counters[TABU])
        if out >= 0:
            spent -= cost[out]
            work -= counters[N_CHOSEN] + _remove(matrix, state, out)
        while counters[N_UNCOVERED] > 0:
            row = state.uncovered[_chance(counters) % counters[N_UNCOVERED]]
            start, end = matrix.row_start[row], matrix.row_start[row + 1]
            work -= end - start
            column = _most_wanted(matrix, state, start, end)
            if column < 0 or spent + cost[column] >= limit:
                break
            spent += cost[column]
            work -= _add(matrix, state, column)
            counters[TABU] = column
            for nth in range(counters[N_UNCOVERED]):
                row = state.uncovered[nth]
                state.weight[row] += 1
                start, end = matrix.row_start[row], matrix.row_start[row + 1]
                work -= end - start
                for entry in range(start, end):
                    state.score[matrix.columns[entry]] += 1
    return 0


@kernel
def _least_missed(matrix: Matrix, state: State, tabu: int) -> int:
    """The chosen column that loses least for its cost, of equals the one chosen longest; or -1."""
    cost, score, changed = matrix.cost, state.score, state.changed
    least = -1
    for nth in range(state.counters[N_CHOSEN]):
        column = state.chosen[nth]
        if column == tabu:
            continue
        if least >= 0:
            ours, theirs = score[column] * cost[least], score[least] * cost[column]
            if ours > theirs or (ours == theirs and changed[column] >= changed[least]):
                continue
        least = column
    return least


@kernel
def _most_wanted(matrix: Matrix, state: State, start: int, end: int) -> int:
    """Of a row's columns, the one that gains most for its cost, of equals the oldest; or -1."""
    cost, score, changed = matrix.cost, state.score, state.changed
    most = -1
    for entry in range(start, end):
        column = matrix.columns[entry]
        if not state.may_add[column]:
            continue
        if most >= 0:
            ours, theirs = score[column] * cost[most], score[most] * cost[column]
            if ours < theirs or (ours == theirs and changed[column] >= changed[most]):
                continue
        most = column
    return most


@kernel
def _add(matrix: Matrix, state: State, column: int) -> int:
    """Choose a column; returns the work. Its score stays: what it gained is what it would lose."""
    counters, times, score = state.counters, state.times, state.score
    state.place[column] = counters[N_CHOSEN]
    state.chosen[counters[N_CHOSEN]] = column
    counters[N_CHOSEN] += 1
    kept, work = score[column], 0
    for at in range(matrix.column_start[column], matrix.column_start[column + 1]):
        row = matrix.rows[at]
        times[row] += 1
        if times[row] == 1:
            start, end = matrix.row_start[row], matrix.row_start[row + 1]
            work += end - start
            for entry in range(start, end):
                score[matrix.columns[entry]] -= state.weight[row]
                state.may_add[matrix.columns[entry]] = True
            last = state.uncovered[counters[N_UNCOVERED] - 1]
            state.uncovered[state.uncovered_place[row]] = last
            state.uncovered_place[last] = state.uncovered_place[row]
            state.uncovered_place[row] = -1
            counters[N_UNCOVERED] -= 1
        elif times[row] == 2:
            score[state.holder[row]] -= state.weight[row]
        state.holder[row] ^= column
    score[column] = kept
    counters[STEP] += 1
    state.changed[column] = counters[STEP]
    return int(work + matrix.column_start[column + 1] - matrix.column_start[column])


@kernel
def _remove(matrix: Matrix, state: State, column: int) -> int:
    """Leave a column out; returns the work."""
    counters, times, score = state.counters, state.times, state.score
    last = state.chosen[counters[N_CHOSEN] - 1]
    state.chosen[state.place[column]] = last
    state.place[last] = state.place[column]
    state.place[column] = -1
    counters[N_CHOSEN] -= 1
    kept, work = score[column], 0
    for at in range(matrix.column_start[column], matrix.column_start[column + 1]):
        row = matrix.rows[at]
        times[row] -= 1
        state.holder[row] ^= column
        if times[row] == 0:
            start, end = matrix.row_start[row], matrix.row_start[row + 1]
            work += end - start
            for entry in range(start, end):
                score[matrix.columns[entry]] += state.weight[row]
                state.may_add[matrix.columns[entry]] = True
            state.uncovered[counters[N_UNCOVERED]] = row
            state.uncovered_place[row] = counters[N_UNCOVERED]
            counters[N_UNCOVERED] += 1
        elif times[row] == 1:
            score[state.holder[row]] += state.weight[row]
    score[column] = kept
    state.may_add[column] = False
    counters[STEP] += 1
    state.changed[column] = counters[STEP]
    return int(work + matrix.column_start[column + 1] - matrix.column_start[column])


@kernel
def _chance(counters: IntArray) -> int:
    """A number up to 2^31, by a linear congruential generator (Knuth's MMIX)."""
    state = np.uint64(counters[CHANCE]) * np.uint64(6364136223846793005)
    state += np.uint64(1442695040888963407)
    counters[CHANCE] = np.int64(state)
    return int(np.int64(state >> np.uint64(33)))


@kernel
def lagrangian_value(
    matrix: Matrix, price: FloatArray, reduced_cost: FloatArray, excess: FloatArray
) -> float:
    """Value of the Lagrangian relaxation at some prices of rows: a bound of the cost from below.

    Each row is paid its price once, and each column that costs less than the prices of its rows
    is chosen. Fills in costs less prices by column, and by row 1 less how often it is covered.
    """
    value = price.sum()
    excess[:] = 1.0
    for column in range(len(reduced_cost)):
        start, end = matrix.column_start[column], matrix.column_start[column + 1]
        left = matrix.cost[column]
        for at in range(start, end):
            left -= price[matrix.rows[at]]
        reduced_cost[column] = left
        if left < 0.0:
            value += left
            for at in range(start, end):
                excess[matrix.rows[at]] -= 1.0
    return float(value)
