"""The first of sampled worlds, and its table."""

from placement.compute import Compute
from placement.sampling.tables import build_sample_tables
from placement.sampling.worlds import draw_samples


def first_world(setting, poses, uncertainty, seed=0, **options):
    """The first world that is sampled."""
    (world,) = draw_samples(
        setting, poses, uncertainty, n_samples=1, seed=seed, **options
    )
    return world


def table_of_world(world, *, seed=0, **options):
    """The one table of a world; options are those of computing."""
    ((_, table),) = build_sample_tables([world], compute=Compute(seed=seed, **options))
    return table
