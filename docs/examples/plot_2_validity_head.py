"""
What the validity head predicts
===============================

The head reads the picture where the arm would be, and tells how likely a configuration is free: a map of the
torus, which is what a path sampler searches.
"""

# %%
# It is asked about a grid, as ``POST /validity`` would be.

import matplotlib.pyplot as plt
import numpy as np

from cspace.bundle import Bundle
from cspace.simulator import Split
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.problems import Family, draw_problem
from cspace.worlds.planar.simulator import render
from inference_api.settings import PRETRAINED_FOLDER

problem = draw_problem(Family.NARROW, Split.DEMO, seed=24)
bundle = Bundle.load(PRETRAINED_FOLDER)
side = 120
angles = np.linspace(-np.pi, np.pi, side, endpoint=False) + np.pi / side
grid = np.stack(np.meshgrid(angles, angles), axis=-1).reshape(-1, 2).astype(np.float32)
confidence, _ = bundle.predict(render(problem.scenario), grid)

# %%
# Where it is wrong about the truth: close to contact, and hardly anywhere else.

free = CollisionChecker(problem.scenario).valid_batch(grid)
right = (confidence >= 0.5) == free
print(
    f"right about {right.mean():.4f} of the torus, sure (above 0.9 or below 0.1) of "
    f"{((confidence > 0.9) | (confidence < 0.1)).mean():.4f}"
)

figure, (map_, wrong) = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained")
extent = (-np.pi, np.pi, -np.pi, np.pi)
image = map_.imshow(confidence.reshape(side, side), extent=extent, origin="lower", cmap="viridis")
map_.contour(angles, angles, free.reshape(side, side), levels=[0.5], colors="white", linewidths=1)
map_.set(title="P(free); the true border in white", xlabel="joint 1 (rad)", ylabel="joint 2 (rad)")
figure.colorbar(image, ax=map_)
wrong.imshow(~right.reshape(side, side), extent=extent, origin="lower", cmap="Reds")
wrong.contour(angles, angles, free.reshape(side, side), levels=[0.5], colors="grey", linewidths=1)
wrong.set(title="where the head is wrong at even odds", xlabel="joint 1 (rad)", ylabel="joint 2 (rad)")
plt.show()
