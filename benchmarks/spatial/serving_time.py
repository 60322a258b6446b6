"""What a running API takes for an arm in space: new pictures, known ones, validity of many configurations.

    python -m benchmarks.spatial.serving_time --model panda-sampler/1 [--url http://127.0.0.1:8000]

Each scene is shown by one noisy picture of 128 x 128. First 300 samples are asked for it, then the same with
another seed, then the validity of 1000 uniform configurations in one .npy. Medians and quartiles of the
client's wall time over scenes after a few that do not count, the stages as the server tells them, which share
of the samples is collision-free (mean over scenes), and the server's memory where its process is named.
"""

import io
import sys
import time
from dataclasses import replace
from typing import Any

import httpx
import numpy as np
import psutil

from benchmarks.command import arguments
from benchmarks.machine import machine
from cspace.simulator import Split, scenario_rng
from cspace.worlds import examples, simulator_of
from services.evaluator.statistics import mean_interval

COUNT, CONFIGURATIONS, WARM = 300, 1000, 5


class SceneRequests:
    """One scene and what is asked of it."""

    def __init__(self, index: int) -> None:
        world = examples()["panda"]
        views = replace(world.sensor.views, count=(1, 1))
        simulator = simulator_of(replace(world, sensor=replace(world.sensor, views=views)))
        rng = scenario_rng(Split.DEMO, 0, index)
        scene = simulator.scene(rng, Split.DEMO, index)
        view, file = simulator.picture_file(scene), io.BytesIO()
        np.save(file, world.space.sample_uniform(rng, CONFIGURATIONS))
        self.checker = simulator.checker(scene)
        self.pages = {
            "new picture": ("/sample", {"image": view}, {"n": str(COUNT), "seed": "1"}),
            "known picture": ("/sample", {"image": view}, {"n": str(COUNT), "seed": "2"}),
            "validity": ("/validity", {"image": view, "configurations": file.getvalue()}, {}),
        }

    def answers(self, client: httpx.Client, model: str) -> dict[str, tuple[float, dict[str, Any]]]:
        """Wall time, ms, and body of each."""
        found = {}
        for name, (page, files, data) in self.pages.items():
            began = time.perf_counter()
            answer = client.post(page, files=files, data={"model": model, **data})
            found[name] = (1e3 * (time.perf_counter() - began), answer.raise_for_status().json())
        return found


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--model", required=True)
    parser.add_argument("--url", default="http://127.0.0.1:8000")
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--pid", type=int, help="of the server, for its memory")
    options = parser.parse_args()
    requests = [SceneRequests(index) for index in range(WARM + options.scenes)]
    with httpx.Client(base_url=options.url, timeout=60.0) as client:
        found = [one.answers(client, options.model) for one in requests][WARM:]
    print(machine())
    for name in found[0]:
        taken, bodies = zip(*(one[name] for one in found), strict=True)
        low, middle, high = np.quantile(taken, (0.25, 0.5, 0.75))
        stages = {
            key: np.median([body["timing_ms"][key] for body in bodies]) for key in bodies[0]["timing_ms"]
        }
        parts = ", ".join(f"{stage} {value:.1f}" for stage, value in stages.items())
        print(f"{name:<16}{middle:7.1f} ms ({low:.1f} to {high:.1f}); server: {parts}")
    samples = [one["known picture"][1] for one in found]
    free = [
        scene.checker.valid_batch(np.array(body["samples"])).mean()
        for scene, body in zip(requests[WARM:], samples, strict=True)
        if body["samples"]
    ]
    print(f"collision-free {mean_interval(free, np.random.default_rng(0)):.4f}")
    print(f"acceptance {np.mean([one['acceptance'] for one in samples]):.3f}")
    print(f"shortfall {np.mean([one['shortfall'] for one in samples]) / COUNT:.4f} of the requested samples")
    if options.pid is not None:
        print(f"memory of the server {psutil.Process(options.pid).memory_info().rss / 2**20:.0f} MiB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
