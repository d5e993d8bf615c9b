"""
Place cameras in ten lines
==========================

The study's junction, two cases, and up to three cameras: where should they be, and what
do they prevent? This page is a script. Its figures and tables are made when the site is
built.
"""

# %% A question is what is driven and how it is judged. ``Question()`` alone is the
# study's 13 cases from four approaches, along the arms of the junction. Here a child
# crosses behind parked cars (CPNCO-50), a cyclist comes out of the side road (CBNA),
# and the car comes from the north or the west.
import placement
from experiments.figures import evaluation, plan

assembly = placement.assemble(
    placement.Question(
        cases="CPNCO-50,CBNA", approaches="north,west", speeds="30,45,60", budget=3
    )
)
setting = assembly.setting
candidates = assembly.candidates
print(len(setting.runs), "runs; the first is", setting.runs[0].id)

# %% Candidates are poses at the scene's sites: every height, direction and tilt of the
# grid; and the study's own.
print(len(candidates), "poses; the first is", candidates[0].id)

# %% The best of them, with a bound for every objective that no layout of this size can
# exceed. Units that add nothing to any objective are left out.
found = placement.place(assembly)
print(found)

# %%
# The layout is evaluated independently, by rendering every frame and braking every car.
judged = placement.evaluate_layout(found.layout, setting)
print(judged)

# %% Plots are matplotlib axes; ``.figure`` shows them in a notebook,
# ``.figure.savefig("plan.png")`` saves them. From above: units and their fields of
# view, the runs, and what stands in the way.
plan.plot_plan(setting, found.layout).figure

# %%
# Who detects the road user when, in the first run.
evaluation.plot_heatmaps(judged, [0])[0].figure

# %%
# As a table of pandas:
judged.to_frame()
