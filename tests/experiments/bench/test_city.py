"""The made-up city of the benchmark, solved in two ways."""

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from experiments.bench.city import (
    build_made_up_city,
    main,
    read_costs,
    share_costs,
    solve_directly,
)
from geometry.errors import InputError
from placement.city.choose import CityWishes, choose


@pytest.mark.parametrize("seed", [0, 1])
def test_a_made_up_city_is_solved_as_by_highs_itself(seed):
    options, weight, budget_eur = build_made_up_city(40, seed=seed)
    choice = choose(options, weight, CityWishes(budget_eur=budget_eur))
    assert choice.certificate.stages[0].gap == 0.0
    theirs = solve_directly(options, weight, budget_eur)
    assert choice.certificate.stages[0].objective == pytest.approx(theirs, abs=1e-6)
    assert options.cost_eur[choice.rows].sum() <= budget_eur
    assert (np.diff(options.apr.reshape(40, 11), axis=1) > 0.0).all()


def test_what_junctions_cost_is_read_shared_out_and_drawn(tmp_path):
    rng = np.random.default_rng(0)
    runs, sites = rng.integers(100, 600, 20), rng.integers(4, 60, 20)
    frames = 60 * runs
    cpu_s = 3.0 + 0.02 * runs + 7.0 * sites * frames / 1.0e6
    rows = {"sites": sites, "runs": runs, "frames": frames, "cpu_s": cpu_s}
    table = pd.DataFrame(rows | {"peak_memory_mib": 500.0})
    refused = table.iloc[:1].assign(cpu_s=0.1, runs=0)  # a junction without lanes
    pd.concat([table, refused]).to_csv(tmp_path / "junctions.csv", index=False)
    costs = read_costs(tmp_path)
    assert len(costs) == 20
    assert share_costs(costs) == pytest.approx((3.0, 0.02, 7.0))
    drawn = CliRunner().invoke(main, [str(tmp_path), "--out", str(tmp_path / "costs.png")])
    assert drawn.exit_code == 0
    assert "20 junctions: " in drawn.output
    assert "3.0 s each, 0.020 s a run, 7.0 s a million sites x frames" in drawn.output
    assert (tmp_path / "costs.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("text", [None, "", "id,name\nn1,here\n", "cpu_s,runs,peak_memory_mib\n"])
def test_a_folder_that_tells_no_costs_is_refused(tmp_path, text):
    if text is not None:
        (tmp_path / "junctions.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"junctions\.csv"):
        read_costs(tmp_path)
