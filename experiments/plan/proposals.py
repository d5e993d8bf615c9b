"""What the optimiser proposes next to one's own plan, and models that it may mount."""

from dataclasses import dataclass
from typing import Any

from geometry.catalogue import load_cameras
from geometry.lidar import load_lidars
from geometry.scene import Scene
from placement.candidates import CandidatePose
from placement.layout import Layout
from placement.planning import own_models

from ..parts.player import unit_records


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proposal:
    """An answer of the optimiser."""

    number: int
    title: str
    words: str
    units: tuple[CandidatePose, ...]
    views: tuple[str, ...]  # of each unit, as an SVG path
    fields: dict[str, Any]

    def record(self, summary: dict[str, Any], scene: Scene) -> dict[str, Any]:
        """It as browsers show it; `summary` is what is known of its units."""
        layout = Layout(name=self.title, units=self.units, scene_name=scene.name)
        return {
            "number": self.number,
            "title": self.title,
            "words": self.words,
            **self.fields,
            **summary,
            "onTable": self.fields["apr"],
            "drawn": [
                {"place": record["place"], "view": view}
                for record, view in zip(unit_records(layout, scene), self.views, strict=True)
            ],
        }


def sensor_words(sensors: str) -> dict[str, str]:
    """By the name of each model that may be mounted, how ``--sensors`` calls it."""
    words = {name: name for name in (*load_cameras(), *load_lidars())}
    for word in filter(None, sensors.split(",")):
        for model in own_models(word).values():
            words[model.name] = f"{word}:{model.name}" if word.endswith(".toml") else word
    return words
