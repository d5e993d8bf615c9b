"""Bill of materials: sensors, sites, and what they cost.

As far as it is known.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

from geometry.catalogue import sensor_kind
from geometry.notes import assumed_sites
from geometry.scene import Scene
from placement.layout import Layout
from placement.wishes import assumed_prices, load_prices, site_price_eur

from ..language import localized, mark, tr, trn
from ..results.numbers import grouped, joined, sensor_words
from ..results.tables import records_csv
from .section import Block, Section, Table

UNKNOWN = mark("unknown")
FILE_NAME = "bill_of_materials.csv"
_KINDS = {"camera": mark("camera"), "lidar": mark("LiDAR")}
_NO_SITE = mark("no site of the scene")
_LEFT_OUT = {
    "edge-computer": mark("detection computer"),
    "radio-unit": mark("radio unit"),
    "commissioning": mark("calibration"),
}
"""What no bill has, by its name in ``placement/data/prices.toml``."""
_SOURCES = {
    "catalogue": mark("catalogue"),
    "told": mark("given"),
    "assumption": mark("assumption"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Item:
    """One line of the bill."""

    # "sensor" or "site".
    part: str
    # The sensor's model, or the site's id.
    name: str
    # "camera", "LiDAR", "lamp post" and so on.
    kind: str
    # Sensors to buy; of a site: 1 to be made ready, 0 if it has units already.
    count: int
    # With those that are there already.
    n_units: int
    # Of one; None: unknown. [EUR]
    price_eur: float | None
    # "catalogue", "told" or "assumption"; empty: the price is unknown
    price_source: str = ""
    # Of a site that the map does not have where it is.
    assumed: str = ""

    @property
    def sum_eur(self) -> float | None:
        """Price of all; None where it is unknown, 0 where none is to buy."""
        if self.count == 0:
            return 0.0
        if self.price_eur is None:
            return None
        return self.count * self.price_eur


@dataclass(frozen=True, slots=True, kw_only=True)
class BillOfMaterials:
    """What a layout takes.

    Attributes
    ----------
    sensors : tuple of Item
        One per model.
    sites : tuple of Item
        One per site that is used, in the layout's order.
    assumed : tuple of str
        What is assumed of sites without a price, in sentences.
    """

    # One per model.
    sensors: tuple[Item, ...]
    # That are used, in the layout's order.
    sites: tuple[Item, ...]
    # Of sites without a price, in sentences.
    assumed: tuple[str, ...] = ()

    @property
    def sensors_eur(self) -> float | None:
        """Price of the sensors to buy; None where one is unknown."""
        return total_eur(self.sensors)

    @property
    def sites_eur(self) -> float | None:
        """Price of all sites; None where one is unknown."""
        return total_eur(self.sites)


def total_eur(items: Iterable[Item]) -> float | None:
    """Price of all items; None where one is unknown."""
    sums = [item.sum_eur for item in items]
    if None in sums:
        return None
    return sum(value for value in sums if value is not None)


def to_buy(bill: BillOfMaterials) -> str:
    """What there is to buy: "2 cameras and 1 LiDAR, and the preparation of 3 poles"."""
    counts = Counter[str]()
    for item in bill.sensors:
        counts[item.kind] += item.count
    sensors = sensor_words(counts[_KINDS["camera"]], counts[_KINDS["lidar"]])
    n_sites = sum(item.count for item in bill.sites)
    if not sensors:
        return tr("nothing")
    if not n_sites:
        return sensors
    return trn(
        "{sensors}, and the preparation of {n} pole",
        "{sensors}, and the preparation of {n} poles",
        n_sites,
        sensors=sensors,
    )


def left_out_sentence() -> str:
    """What no bill has, with the sum that is assumed for it."""
    left_out = load_prices().left_out
    names = joined([tr(_LEFT_OUT[name]) for name in left_out])
    total = sum(part.eur for part in left_out.values())
    return tr(
        "Not included: {names} (about {sum}, assumed).",
        names=names,
        sum=_euros(total),
    )


def build_bill(
    layout: Layout,
    scene: Scene,
    *,
    site_cost_eur: float | None = None,
    kept_ids: Collection[str] = (),
) -> BillOfMaterials:
    """Sensors and sites that a layout needs.

    A cost of 0 is unknown: that of a site is then assumed by its kind, unless
    `site_cost_eur` was said for every site. Units of `kept_ids` exist: neither they nor
    their sites are paid for.
    """
    used = {unit.site_id for unit in layout.units}
    used -= {unit.site_id for unit in layout.units if unit.id in kept_ids}
    to_make = [one for one in scene.sites if one.id in used and site_cost_eur is None]
    of_model = grouped((unit.sensor.name, unit) for unit in layout.units)
    return BillOfMaterials(
        sensors=tuple(
            Item(
                part="sensor",
                name=name,
                kind=_KINDS[sensor_kind(sensor)],
                count=sum(unit.id not in kept_ids for unit in units),
                n_units=len(units),
                price_eur=sensor.price_eur if sensor.price_eur > 0.0 else None,
                price_source="catalogue" if sensor.price_eur > 0.0 else "",
            )
            for name, units in of_model.items()
            for sensor in [units[-1].sensor]
        ),
        sites=_site_items(layout, scene, site_cost_eur, kept_ids),
        assumed=assumed_prices(load_prices(), to_make),
    )


def _site_items(
    layout: Layout, scene: Scene, site_cost_eur: float | None, kept_ids: Collection[str]
) -> tuple[Item, ...]:
    doubts = assumed_sites(scene.notes)
    sites = {site.id: site for site in scene.sites}
    used = grouped(
        (unit.site_id if unit.site_id in sites else None, unit.id)
        for unit in layout.units
    )
    items = []
    for site_id, unit_ids in used.items():
        kept = [unit_id for unit_id in unit_ids if unit_id in kept_ids]
        if site_id is None:
            name = _NO_SITE
            kind = UNKNOWN
            price_eur = site_cost_eur
            source = ""
            # Nobody knows which of them share a mount.
            count = len(unit_ids) - len(kept)
        else:
            site = sites[site_id]
            name = site_id
            kind = site.kind
            count = int(not kept)
            price_eur = site_price_eur(site, site_cost_eur)
            source = "told" if site.cost_eur > 0.0 else "assumption"
        item = Item(
            part="site",
            name=name,
            kind=kind,
            count=count,
            n_units=len(unit_ids),
            price_eur=price_eur,
            price_source=source if site_cost_eur is None else "told",
            assumed=doubts.get(site_id or "", ""),
        )
        items.append(item)
    return tuple(items)


def bill_of_materials_csv(bill: BillOfMaterials) -> str:
    """The bill as CSV, a row per item.

    What is unknown is empty, and there is no row of sums.
    """
    heads = ["part", "name", "kind", "units", "to_buy", "price_eur", "sum_eur"]
    heads += ["price_source", "assumed"]
    rows = []
    for item in (*bill.sensors, *bill.sites):
        amounts = [
            "" if eur is None else f"{eur:g}" for eur in (item.price_eur, item.sum_eur)
        ]
        counts = [item.n_units, item.count]
        source = [item.price_source, item.assumed]
        rows.append([item.part, item.name, item.kind, *counts, *amounts, *source])
    records = [dict(zip(heads, row, strict=True)) for row in rows]
    return records_csv(records, heads)


def bill_sentences(bill: BillOfMaterials) -> list[str]:
    """The sum as far as it is known."""
    items = [*bill.sensors, *bill.sites]
    known = sum(item.sum_eur for item in items if item.sum_eur is not None)
    unknown = [item for item in items if item.sum_eur is None]
    if not unknown:
        return [tr("All lines together: {sum}.", sum=_euros(known))]
    if len(unknown) == len(items):
        return [tr("No price is known.")]
    n_models = sum(item.part == "sensor" for item in unknown)
    n_places = sum(item.count for item in unknown if item.part == "site")
    models = trn("{n} sensor model", "{n} sensor models", n_models)
    places = trn("{n} mounting place", "{n} mounting places", n_places)
    what = [words for n, words in ((n_models, models), (n_places, places)) if n]
    return [
        tr(
            "At least {sum}, the sum of all known prices. The price of {what} is"
            " unknown and comes on top.",
            sum=_euros(known),
            what=joined(what),
        )
    ]


def bill_tables(bill: BillOfMaterials) -> list[Table]:
    """Sensors by model, and sites; each with a row for all together."""
    sensors = bill.sensors
    sites = bill.sites
    rows = []
    for one in sensors:
        price = tr(UNKNOWN) if one.price_eur is None else _amount(one.price_eur)
        rows.append(
            [
                one.name,
                tr(one.kind),
                str(one.n_units),
                str(one.count),
                price,
                _sum([one]),
            ]
        )
    n_units = sum(one.n_units for one in sensors)
    n_to_buy = sum(one.count for one in sensors)
    rows.append([tr("all"), "", str(n_units), str(n_to_buy), "", _sum(sensors)])
    columns = [
        tr("model"),
        tr("kind"),
        tr("units"),
        tr("to buy"),
        tr("price of one (EUR)"),
        tr("sum (EUR)"),
    ]
    # Nothing exists already.
    if n_to_buy == n_units:
        columns = [*columns[:3], *columns[4:]]
        rows = [[*row[:3], *row[4:]] for row in rows]
    of_sites = []
    for one in sites:
        name = tr(_NO_SITE) if one.name == _NO_SITE else one.name
        if one.assumed:
            name = tr("{site} (assumed)", site=name)
        price = tr("already there") if one.count == 0 else _sum([one])
        source = tr(_SOURCES[one.price_source]) if one.price_source else ""
        of_sites.append([name, tr(one.kind), str(one.n_units), price, source])
    of_sites.append(
        [tr("all"), "", str(sum(one.n_units for one in sites)), _sum(sites), ""]
    )
    return [
        Table(caption=tr("Sensors"), columns=columns, rows=rows, numeric=range(2, 6)),
        Table(
            caption=tr("Sites"),
            columns=[
                tr("site"),
                tr("kind"),
                tr("units"),
                tr("preparation (EUR)"),
                tr("price"),
            ],
            rows=of_sites,
            numeric=range(2, 4),
        ),
    ]


def bill_section(bill: BillOfMaterials) -> Section:
    """The bill, and what is not in it."""
    note = tr(
        "Prices are from the sensor catalogue, for one outdoor unit with its "
        "housing; those supplied with this program are orders of magnitude. "
        "“Unknown” does not mean zero. Also not included:"
    )
    missing = [
        tr("brackets, cables and junction boxes not covered by a site's cost"),
        tr("spare units"),
        tr(
            "planning, permits, traffic management while mounting, the lift and"
            " the people"
        ),
        tr(
            "electricity, data connection, cleaning, repair and replacement"
            " over the years"
        ),
        tr("value added tax"),
    ]
    if not bill.assumed:
        missing.insert(0, tr("new poles and foundations"))
    # Assumed costs are with poles.
    blocks: list[Block] = [
        " ".join([*bill_sentences(bill), left_out_sentence(), *map(tr, bill.assumed)]),
        *bill_tables(bill),
        f"{note} {'; '.join(missing)}.",
    ]
    return Section("bill", tr("Bill of materials"), blocks)


def _sum(items: Sequence[Item]) -> str:
    """Price of all items; of those that are known, where one is not."""
    values = [item.sum_eur for item in items]
    known = [value for value in values if value is not None]
    if not known:
        return tr(UNKNOWN)
    if len(known) == len(values):
        return _amount(sum(known))
    return f"≥ {_amount(sum(known))}"


def _amount(value: float) -> str:
    return localized(f"{value:,.0f}" if value == round(value) else f"{value:,.2f}")


def _euros(value: float) -> str:
    return tr("{amount} EUR", amount=_amount(value))
