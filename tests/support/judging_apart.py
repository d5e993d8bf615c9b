"""Judges that need an environment of their own: run by ``judging.py``, imports no other
module.

``python judging_apart.py KIND FOLDER`` writes what it found as JSON. The packages that
each kind needs contradict those of this project: they ask for an older lxml, numpy or
protobuf.
"""

import importlib.metadata
import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any


def judge_by_asam(kind: str, folder: Path) -> dict[str, Any]:
    """Issues that ASAM's checker finds in every .xosc (or .xodr) file of a folder."""
    from importlib import import_module

    from qc_baselib import Configuration, Result  # type: ignore[import-not-found]

    package = {"xosc": "qc_openscenario", "xodr": "qc_opendrive"}[kind]
    check, constants = (
        import_module(f"{package}.{name}") for name in ("main", "constants")
    )
    statuses: Counter[str] = Counter()
    issues = []
    paths = sorted(folder.glob(f"*.{kind}"))

    for path in paths:
        config = Configuration()
        result = Result()
        config.set_config_param("InputFile", str(path))
        result.register_checker_bundle(
            name=constants.BUNDLE_NAME,
            description="",
            version="",
            summary="",
        )
        check.run_checks(config, result)

        for checker_id in result.get_checker_ids(constants.BUNDLE_NAME):
            statuses[str(result.get_checker_status(checker_id).value)] += 1
            found = result.get_issues(constants.BUNDLE_NAME, checker_id)
            issues += [
                f"{path.name}: {checker_id}: {issue.description}" for issue in found
            ]

    name = {"xosc": "asam-qc-openscenarioxml", "xodr": "asam-qc-opendrive"}[kind]
    version = importlib.metadata.version(name)
    return {
        "version": version,
        "n": len(paths),
        "checks": statuses,
        "issues": issues,
    }


def judge_touches(folder: Path) -> dict[str, Any]:
    """First time at which the two rectangles of each run collide; null: never.

    `folder` has ``NAME.npz`` for each run: half_sizes (2, 2) [m], time_s (n,), and for
    both bodies pose (2, n, 3): x, y [m], yaw [rad]. Times are in seconds.
    """
    import numpy as np
    from commonroad_dc.pycrcc import RectOBB  # type: ignore[import-not-found]

    touch_s: dict[str, float | None] = {}

    for path in sorted(folder.glob("*.npz")):
        run = np.load(path)
        steps = zip(run["time_s"].tolist(), *run["pose"].tolist(), strict=True)
        touch_s[str(run["id"])] = next(
            (
                time_s
                for time_s, *poses in steps
                if RectOBB(*run["half_sizes"][0], poses[0][2], *poses[0][:2]).collide(
                    RectOBB(*run["half_sizes"][1], poses[1][2], *poses[1][:2])
                )
            ),
            None,
        )

    version = importlib.metadata.version("commonroad-drivability-checker")
    return {"version": version, "touch_s": touch_s}


def judge_transforms(folder: Path) -> dict[str, Any]:
    """Place [m] and axes ahead, right and up of each unit of ``layout.json`` in
    CARLA.
    """
    import carla  # type: ignore[import-not-found]

    axes = {}
    for unit in json.loads((folder / "layout.json").read_text()):
        found = carla.Transform(
            carla.Location(**unit["transform"]["location"]),
            carla.Rotation(**unit["transform"]["rotation"]),
        )
        vectors = (
            found.location,
            found.get_forward_vector(),
            found.get_right_vector(),
            found.get_up_vector(),
        )
        axes[unit["id"]] = [[vector.x, vector.y, vector.z] for vector in vectors]

    return {"version": importlib.metadata.version("carla"), "axes": axes}


if __name__ == "__main__":
    kind = sys.argv[1]
    folder = Path(sys.argv[2])
    judges = {"touch": judge_touches, "carla": judge_transforms}
    answer = judges[kind](folder) if kind in judges else judge_by_asam(kind, folder)
    sys.stdout.write(json.dumps(answer) + "\n")
