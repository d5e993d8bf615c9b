"""Files of plans and layouts: read and written."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from geometry.errors import InputError, refuse
from geometry.phrases import Phrase
from geometry.scene import Scene
from geometry.tables import read_table
from geometry.text_formats import parse_json
from placement.candidates import CandidatePose
from placement.layout import Layout, at_sites, check_layout, read_layout
from placement.question import Question, read_question

from ..export.json import to_json, to_json_text
from ..language import mark
from .background import Background, read_background
from .plan import (
    MAX_UNITS,
    MAX_VARIANTS,
    PlanState,
    Variant,
    check_count,
    printable_name,
)
from .poles import PolePlace

SCHEMA = "place-rsus/plan/1"
"""What a plan's file says that it is; a layout's file says nothing of the kind."""
MAX_PLAN_BYTES = 16_000_000
"""Of a plan's file."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """Contents of a plan's file.

    Attributes
    ----------
    variants : tuple of Variant
        The first one is worked on at first.
    scene_name : str
        Of the scene that it is for; empty: of any.
    background : Background, optional
        Image below the plan.
    poles : tuple of PolePlace
        Of one's own.
    question : Question, optional
        The one that the layout was found for; ``summary.json`` has it.
    existing : tuple of CandidatePose
        Units of the variants that are mounted already, as the file says.
    """

    variants: tuple[Variant, ...]
    scene_name: str = ""
    background: Background | None = None
    poles: tuple[PolePlace, ...] = ()
    question: Question | None = None
    existing: tuple[CandidatePose, ...] = ()


def check_plan(plan: Plan, scene: Scene) -> Plan:
    """A plan whose units are at the sites of a scene, see :func:`.layout.at_sites`.

    Raises InputError unless all of its variants can be mounted there.
    """
    variants = []
    for variant in plan.variants:
        if variant.units:
            layout = Layout(
                name=variant.name, units=variant.units, scene_name=plan.scene_name
            )
            check_layout(layout, scene)
            variant = replace(variant, units=at_sites(layout, scene).units)
        variants.append(variant)
    return replace(plan, variants=tuple(variants))


def read_plan(text: bytes, where: str) -> Plan:
    """A plan from the contents of a plan's file, a layout's, or a summary's.

    Parameters
    ----------
    text : bytes
        JSON; nothing of it is trusted.
    where : str
        Name of the file, for messages; a layout without a name gets its stem.

    Raises
    ------
    InputError
        It is neither, or has more than there may be.
    """
    document = parse_json(text, where, mark("a layout or a plan as JSON"))
    background = None
    if isinstance(document, dict) and document.get("schema") == SCHEMA:
        variants = _read_variants(document.get("variants"), where)
        records = document["variants"]
        drawn = document.get("background")
        if drawn is not None:
            background = read_background(drawn, f"{where}: background")
    else:
        variants = [_read_variant(document, text, where, Path(where).stem)]
        records = [document]
    existing: list[CandidatePose] = []
    for record, variant in zip(records, variants, strict=True):
        existing.extend(read_existing(record, variant.units, where))
    poles = read_table(document.get("poles", []), list[PolePlace], f"{where}: poles")
    check_count(len(poles), f"{where}: poles", MAX_UNITS)
    return Plan(
        variants=tuple(variants),
        scene_name=str(document.get("scene", "")),
        background=background,
        poles=tuple(poles),
        question=_read_question(document, where),
        existing=tuple(existing),
    )


def read_existing(
    document: dict[str, Any], units: Sequence[CandidatePose], where: str
) -> list[CandidatePose]:
    """Those of some units that exist, as a summary's or a layout's file says.

    InputError: the file does not name them by their ids.
    """
    ids = read_table(document.get("existing", []), list[str], f"{where}: existing")
    return [unit for unit in units if unit.id in ids]


def _read_question(document: dict[str, Any], where: str) -> Question | None:
    """The question of a summary's file; None for other files. InputError: it is none."""
    asked = document.get("asked")
    if not isinstance(asked, dict) or not isinstance(asked.get("question"), dict):
        return None
    return read_question(asked["question"], f"{where}: asked")


def _read_variants(records: Any, where: str) -> list[Variant]:
    """Variants of a plan's file, of which some may be empty; InputError: they are none."""
    if not isinstance(records, list) or not 1 <= len(records) <= MAX_VARIANTS:
        there = Phrase("{file}: variants", file=Phrase(where))
        refuse(there, mark("none"), Phrase("a list of 1 to {n}", n=MAX_VARIANTS))
    variants = []
    for index, record in enumerate(records):
        at = f"{where}: variants[{index}]"
        if not isinstance(record, dict):
            raise InputError(at, record, mark("a layout"))
        name = record.get("name")
        # A layout's file has at least one unit; a variant may have none yet.
        if record.get("layout") == [] and isinstance(name, str):
            variants.append(Variant(name=printable_name(name)))
        else:
            encoded = msgspec.json.encode(record)
            variants.append(_read_variant(record, encoded, at, f"{index + 1}"))
    return variants


def _read_variant(document: Any, text: bytes, where: str, name: str) -> Variant:
    """A layout as a variant; too many units are refused before they are read."""
    if isinstance(document, dict) and isinstance(document.get("layout"), list):
        check_count(len(document["layout"]), f"{where}: units", MAX_UNITS)
    layout = read_layout(text, where=where, name=name)
    return Variant(name=printable_name(layout.name), units=layout.units)


def layout_text(state: PlanState, scene: Scene) -> str:
    """The current variant as the layout file of ``--layout``.

    Raises InputError if nothing is mounted.
    """
    record = _variant_record(state, state.variant, scene)
    return to_json_text({**record, **_pole_places(state)})


def _variant_record(state: PlanState, variant: Variant, scene: Scene) -> dict[str, Any]:
    """A variant as a layout's file has it, with the ids of its existing units."""
    record: dict[str, Any] = json.loads(to_json(variant.layout(scene)))
    existing = state.existing_ids(variant.units)
    if existing:
        record["existing"] = sorted(existing)
    return record


def _pole_places(state: PlanState) -> dict[str, Any]:
    """Poles of one's own as files have them; nothing where there is none."""
    places = []
    for pole in state.poles:
        x_m, y_m, _ = pole.position_m.tolist()
        places.append({"id": pole.id, "x_m": x_m, "y_m": y_m})
    if not places:
        return {}
    return {"poles": places}


def plan_text(
    state: PlanState, scene: Scene, background: Background | None = None
) -> str:
    """All variants in one file, each as a layout file has it, and the image below them.

    Parameters
    ----------
    state : PlanState
        Variants and poles.
    scene : Scene
        Without poles of one's own.
    background : Background, optional
        Image below the plan.
    """
    variants = []
    for variant in state.variants:
        if variant.units:
            variants.append(_variant_record(state, variant, scene))
        else:
            variants.append({"name": variant.name, "layout": []})
    record: dict[str, Any] = {
        "schema": SCHEMA,
        "scene": scene.name,
        "variants": variants,
        **_pole_places(state),
    }
    if background is not None:
        record["background"] = msgspec.to_builtins(background)
    return to_json_text(record)
