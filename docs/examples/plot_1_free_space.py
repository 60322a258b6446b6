"""
A scenario, its free space, and samples
=======================================

What the arm may do is a region of the torus of its two angles. The model that ships has seen the picture
alone, and draws configurations of that region.
"""

# %%
# A problem of the family *narrow*: a narrow passage lies on every path from start to goal.

from cspace.bundle import Bundle
from cspace.simulator import Split
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.problems import Family, draw_problem
from cspace.worlds.planar.simulator import render
from inference_api.settings import PRETRAINED_FOLDER

problem = draw_problem(Family.NARROW, Split.DEMO, seed=24)
picture = render(problem.scenario)

# %%
# Samples as a server would give them: what the validity head takes for a collision is left out.

bundle = Bundle.load(PRETRAINED_FOLDER)
found = bundle.sample(picture, 600, seed=7)
free = CollisionChecker(problem.scenario).valid_batch(found.samples)
print(f"{free.mean():.4f} of {len(free)} samples are collision-free")

# %%
# The checker's truth in grey: where the arm would touch a disc.

import matplotlib.pyplot as plt
import numpy as np

angles = np.linspace(-np.pi, np.pi, 200, endpoint=False)
grid = np.stack(np.meshgrid(angles, angles), axis=-1).reshape(-1, 2)
blocked = ~CollisionChecker(problem.scenario).valid_batch(grid).reshape(200, 200)

figure, (seen, torus) = plt.subplots(1, 2, figsize=(10, 4.6), layout="constrained")
camera = problem.scenario.camera
seen.imshow(picture, extent=(camera.x_min_m, camera.x_max_m, camera.y_min_m, camera.y_max_m))
seen.set(title="all that the model sees", xlabel="x (m)", ylabel="y (m)")
torus.imshow(blocked, extent=(-np.pi, np.pi, -np.pi, np.pi), origin="lower", cmap="Greys", vmax=3)
torus.scatter(*found.samples[free].T, s=6, label="free")
torus.scatter(*found.samples[~free].T, s=30, marker="x", color="tab:red", label="in collision")
torus.set(title="configurations", xlabel="joint 1 (rad)", ylabel="joint 2 (rad)")
torus.legend(loc="upper right")
plt.show()
