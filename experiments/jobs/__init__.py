"""Jobs: all that a command does, from its question to its result."""

from typing import Any

READY: dict[str, Any] = {
    "modules": (
        "experiments.report.page",
        "placement.explain.tolerances",
        # The compiler.
        "placement.visibility.point_kernels",
        "placement.visibility.ray_kernels",
        "scipy.integrate",
        "scipy.optimize",
        "trimesh",
    ),
    "prepare": "placement.compile_ahead:compile_ahead",
}
"""What a second process loads while it has nothing to do, as its tasks will need it.

"prepare" compiles what the first process will need, where nothing was compiled yet."""
