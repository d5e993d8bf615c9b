"""Recordings written by hand, line by line."""

from dataclasses import dataclass, field

import pytest

BOX = "100 200 140 300"  # 40 x 100 px


@dataclass
class Folder:
    """Files of a recording, written when asked for."""

    files: dict[str, str] = field(default_factory=dict)

    def add(self, name, line):
        self.files[name] = self.files.get(name, "") + line + "\n"

    def drive(
        self,
        scenario,
        first,
        *,
        speeds,
        closing,
        n_frames,
        detected,
        actor="pedestrian",
        resets=0,
    ):
        """A drive that ends 2 m apart; `detected`: per unit, frames before the impact.

        Every unit has a label of the VRU in every frame. Returns the next free frame
        number.
        """
        for index in range(n_frames + resets):
            if index < n_frames:
                before = n_frames - 1 - index
            else:
                before = n_frames - 1

            name = f"{scenario}_{first + index}.txt"
            distance = 2.0 + closing * before / 10.0
            # As the generator does: no line break at the end.
            self.files[f"WorldData/{name}"] = f"{distance!r} {speeds[0]} {speeds[1]}"
            self.files[f"Eval/{name}"] = ""
            for unit, frames in detected.items():
                self.add(f"{unit}/{name}", f"{actor} {BOX} 20.0")
                if index < n_frames and before in frames:
                    self.add(f"Eval/{name}", f"{unit} {actor} {BOX} 0.9")

        return first + n_frames + resets

    def write(self, folder):
        for name, text in self.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
        return folder


@pytest.fixture
def small():
    """Two drives of a pedestrian by two units and the car; see test_evaluate.py for the
    numbers.
    """
    folder = Folder()
    number = folder.drive(
        3,
        0,
        speeds=(10.0, 1.5),
        closing=10.0,
        n_frames=12,
        detected={"0": (9, 7), "1": (8,), "car": (10, 9, 8)},
        resets=30,
    )
    folder.drive(
        3,
        number,
        speeds=(15.0, 1.5),
        closing=15.0,
        n_frames=16,
        detected={"0": (12, 11, 10), "1": (10, 9, 8), "car": ()},
        resets=30,
    )
    return folder


@pytest.fixture
def new_folder():
    """Builds folders of recordings."""
    return Folder
