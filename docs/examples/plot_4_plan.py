"""
A plan
======

RRT with uniform samples and with those of a path sampler, which knows start and goal, on one narrow problem.
"""

# %%
# The path sampler is made of the shipped model's validity head; nothing is trained.

import tempfile
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import matplotlib.pyplot as plt

from cspace.files import encode_png
from cspace.simulator import Split
from cspace.worlds.planar.problems import Family, draw_problem
from cspace.worlds.planar.simulator import render
from inference_api.settings import PRETRAINED_FOLDER
from services.planner.ompl_planner import solve
from services.planner.plotting import plot_configurations
from services.planner.result import PlannerSettings
from services.planner.samples import LocalSampler
from training import path_sampler

problem = draw_problem(Family.NARROW, Split.DEMO, seed=24)
folder = Path(tempfile.mkdtemp()) / "path-sampler"
with redirect_stdout(StringIO()):  # a command, which tells where it wrote
    path_sampler.main([str(PRETRAINED_FOLDER), str(folder)])
ends = {"start": tuple(problem.start), "goal": tuple(problem.goal)}
batch = LocalSampler(folder).sample(encode_png(render(problem.scenario)), 300, seed=7, **ends)

# %%
# One problem with one seed tells nothing by itself; the results have hundreds, with intervals.

settings = PlannerSettings(seed=1)
results = {"uniform samples": (solve(problem, settings), None)}
results["samples along the path"] = (solve(problem, settings, batch.samples), batch.samples)

figure, panels = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
for axes, (name, (result, samples)) in zip(panels, results.items(), strict=True):
    plot_configurations(axes, problem, result, samples, (0, 1))
    axes.set_title(f"{name}: {result.iterations} iterations")
plt.show()
