"""Draw crops, train, test, export the network that is shipped.

Needs the group ``train``.

``uv run --group train python -m experiments.perception_lab.training --map A.osm ..
--out vru``; crops are stored in a folder, so that a call that was stopped goes on.
"""

import time
from pathlib import Path

import click
import torch

from geometry.errors import InputError
from placement.compute import Compute

from .card import card_text, fit_table
from .crops import (
    LabelledCrops,
    draw_crops,
    join_crops,
    load_crops,
    load_junction,
    save_crops,
)
from .network import Recipe, VruNetwork, export_onnx, find_boxes, train

_EXPORT_PX = 160


@click.command()
@click.option(
    "--map", "maps", multiple=True, required=True, help="To train on: a map's file."
)
@click.option(
    "--held-out", multiple=True, required=True, help="To test on; town05 is built in."
)
@click.option("--crops", "folder", type=click.Path(path_type=Path), default="crops")
@click.option(
    "--per-map", default=1000, show_default=True, help="Crops of each drawing."
)
@click.option(
    "--drawings", default=2, show_default=True, help="Of each map, with other seeds."
)
@click.option("--per-held-out", default=1200, show_default=True)
@click.option("--steps", default=3000, show_default=True, help="Batches of 64 crops.")
@click.option("--seed", default=11, show_default=True)
@click.option("--threads", default=1, show_default=True)
@click.option(
    "--bfloat16", is_flag=True, help="Faster where the processor multiplies in 16 bits."
)
@click.option("--out", type=click.Path(path_type=Path), required=True)
def main(
    *,
    maps: tuple[str, ...],
    held_out: tuple[str, ...],
    folder: Path,
    per_map: int,
    drawings: int,
    per_held_out: int,
    steps: int,
    seed: int,
    threads: int,
    bfloat16: bool,
    out: Path,
) -> None:
    """Train the detector of pedestrians and cyclists.

    Write vru.onnx, its card and its table.
    """
    torch.set_num_threads(threads)
    folder.mkdir(parents=True, exist_ok=True)
    out.mkdir(parents=True, exist_ok=True)
    learnt = [
        _crops(name, folder, n=per_map, seed=seed + drawing)
        for drawing in range(drawings)
        for name in maps
    ]
    tested = {
        name: _crops(name, folder, n=per_held_out, seed=seed + drawings)
        for name in held_out
    }
    crops = join_crops(learnt)
    has_gpu = torch.cuda.is_available()
    recipe = Recipe(
        steps=steps, seed=seed, bfloat16=bfloat16, device="cuda" if has_gpu else "cpu"
    )
    click.echo(
        f"{len(crops)} crops to train on, {sum(map(len, tested.values()))} to test on"
    )
    started = time.monotonic()

    def tell(done: int, loss: float, network: VruNetwork) -> None:
        click.echo(
            f"step {done} of {steps}: loss {loss:.4f},"
            f" {time.monotonic() - started:.0f} s"
        )
        export_onnx(network, out / "vru.onnx", side_px=_EXPORT_PX)

    network = train(crops, recipe, tell=tell, checkpoint=out / "checkpoint.pt")
    export_onnx(network, out / "vru.onnx", side_px=_EXPORT_PX)
    held = join_crops(list(tested.values()))
    found = find_boxes(network, held)
    names = [Path(name).stem for name in maps]
    apart = [Path(name).stem for name in held_out]
    text = card_text(
        network, crops, held, found, held_out=apart, names=names, recipe=recipe
    )
    (out / "vru.md").write_text(text, encoding="utf-8")
    table = fit_table(
        held,
        found,
        source=f"crops of junctions held out ({', '.join(apart)})",
        command="python -m experiments.perception_lab.training",
        compute=Compute(seed=seed),
    )
    (out / "vru.toml").write_text(table, encoding="utf-8")
    click.echo(text)


def _crops(name: str, folder: Path, *, n: int, seed: int) -> LabelledCrops:
    """Crops of a junction, drawn once."""
    path = folder / f"{Path(name).stem}-{seed}.npz"
    if not path.exists():
        click.echo(f"{path}: drawing {n} crops")
        new = path.with_suffix(".part.npz")
        save_crops(new, draw_crops(load_junction(name), n, seed=seed))
        new.replace(path)
    return load_crops(path)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        raise SystemExit(f"error: {error}") from None
