"""Explanations of a layout: what its units contribute, what it misses, what else would do.

``contributions`` takes one or two units away, or adds one;
``unavoided`` says why runs are not avoided, ``agreement`` where detection table and evaluator
differ, ``tolerances`` what errors of mounting do. ``alternatives`` are
layouts that other priorities would choose, of which it picks one by the evaluator. ``conflicts``
finds the smallest set of demands that no layout meets, with the search of ``feasible_sets``.
"""
