"""Choose what to mount: question -> assembly -> detection table -> layout -> evaluation.

``assemble()`` makes of a question what every answer needs - scene, runs, candidates,
wishes, and when asked the detection table and the problem -, ``place()`` finds the
proven layout, ``refine()`` looks between the poses of the grid, ``evaluate_layout()``
judges any layout by full perception and emergency braking, ``verify_certificate()``
checks a proof. Every stage can be entered with its own values: ``visibility`` builds
the table, ``optimiser`` solves it, ``explain`` says why.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
