"""
A depth picture, and what is predicted of the rest
==================================================

An arm of seven joints before a shelf, seen by depth cameras. What no picture shows is hidden space: the model
has learned what such scenes are like, and is less confident there.
"""

# %%
# A scene with its pictures, as the training draws them: noise, holes, and the arm in its own way.

import matplotlib.pyplot as plt
import numpy as np

from cspace.bundle import Bundle
from cspace.simulator import Split
from cspace.worlds import checker_of, picture_file_of, simulator_of
from cspace.worlds.spatial.view import read_view
from inference_api.settings import PRETRAINED_FOLDER

bundle = Bundle.load(PRETRAINED_FOLDER.with_name("pretrained_panda"))
world = bundle.spec.world
problem = simulator_of(world).problem("shelf", Split.DEMO, 12)
file = picture_file_of(problem.scenario)
depth_mm = read_view(file, world.body).pictures[0]

# %%
# Configurations about start and goal, where a planner would ask, with the ground truth beside the prediction.

random = np.random.default_rng(12)
ends = np.array([problem.start, problem.goal])[np.arange(500) % 2]
rows = world.space.to_float32(world.space.bound(ends + random.normal(0.0, 0.3, ends.shape)))
confidence, unseen = bundle.predict(world.read_picture(file), rows)
free = checker_of(problem.scenario).valid_batch(rows)
passes = confidence >= bundle.spec.confidence_threshold
print(
    f"{free.mean():.3f} of them are free; of the {passes.sum()} that pass the model's threshold, "
    f"{free[passes].mean():.3f}"
)

figure, (taken, predicted) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
image = taken.imshow(np.where(depth_mm > 0, depth_mm * 1e-3, np.nan), cmap="viridis")
taken.set(title="a depth picture; white has no reading", xlabel="column (pixels)", ylabel="row (pixels)")
figure.colorbar(image, ax=taken, label="depth (m)")
for chosen, colour, marker, label in (
    (free, "tab:blue", "o", "free"),
    (~free, "tab:red", "x", "in collision"),
):
    predicted.scatter(unseen[chosen], confidence[chosen], s=14, c=colour, marker=marker, label=label)
predicted.axhline(bundle.spec.confidence_threshold, color="black", linewidth=0.8, linestyle="--")
predicted.set(
    title="prediction and ground truth; the threshold dashed",
    xlabel="share of the arm in unseen space",
    ylabel="P(free)",
)
predicted.legend()
plt.show()
