"""What a running API takes for an arm in space: new pictures, known ones, and validity of many configurations.

    python -m benchmarks.spatial.serving_time --model panda-sampler/1 [--url http://127.0.0.1:8000]

Each scene is shown by one noisy picture of 128 x 128. First 300 samples are asked for it, then the same with
another seed, then the validity of 1000 uniform configurations in one .npy, and back. Medians and quartiles of
the client's wall time over scenes after a few that do not count, with the stages as the server tells them, and
the largest memory of the server where it runs on this machine.
"""

import io
import sys
import time
from dataclasses import replace

import httpx
import numpy as np
import psutil

from benchmarks.command import arguments
from benchmarks.machine import machine
from cspace.splits import Split, scenario_rng
from cspace.worlds import examples, workshop_of

COUNT, CONFIGURATIONS, WARM = 300, 1000, 5


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--model", required=True)
    parser.add_argument("--url", default="http://127.0.0.1:8000")
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--pid", type=int, help="of the server, for its memory")
    options = parser.parse_args()
    world = examples()["panda"]
    sensor = replace(world.sensor, views=replace(world.sensor.views, count=(1, 1)))
    world = replace(world, sensor=sensor)
    shop = workshop_of(world)
    times: dict[str, list[float]] = {}
    stages: dict[str, list[dict[str, float]]] = {}
    answers: list[dict[str, Any]] = []
    precisions: list[float] = []
    with httpx.Client(base_url=options.url, timeout=60.0) as client:
        for index in range(WARM + options.scenes):
            rng = scenario_rng(Split.DEMO, 0, index)
            view = shop.picture_file(shop.scene(rng, Split.DEMO, index))
            file = io.BytesIO()
            np.save(file, world.space.sample_uniform(rng, CONFIGURATIONS))
            asks = {
                "new picture": ("/sample", {"image": view}, {"n": str(COUNT), "seed": "1"}),
                "known picture": ("/sample", {"image": view}, {"n": str(COUNT), "seed": "2"}),
                "validity": ("/validity", {"image": view, "configurations": file.getvalue()}, {}),
            }
            for name, (page, files, data) in asks.items():
                began = time.perf_counter()
                answer = client.post(page, files=files, data={"model": options.model, **data})
                taken = 1e3 * (time.perf_counter() - began)
                body = answer.raise_for_status().json()
                if index >= WARM:
                    times.setdefault(name, []).append(taken)
                    stages.setdefault(name, []).append(body["timing_ms"])
                    answers.append(body)
    print(machine())
    for name, taken in times.items():
        low, middle, high = np.quantile(taken, (0.25, 0.5, 0.75))
        told = {stage: float(np.median([one[stage] for one in stages[name]])) for stage in stages[name][0]}
        parts = ", ".join(f"{stage} {value:.1f}" for stage, value in told.items())
        print(f"{name:<16}{middle:7.1f} ms ({low:.1f} to {high:.1f}); server: {parts}")
    sampled = [one for one in answers if "shortfall" in one]
    print(f"acceptance {np.mean([one['acceptance'] for one in sampled]):.3f}", end=", ")
    print(f"shortfall {np.mean([one['shortfall'] for one in sampled]) / COUNT:.4f} of what was asked")
    if options.pid is not None:
        process = psutil.Process(options.pid)
        print(f"memory of the server now {process.memory_info().rss / 2**20:.0f} MiB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
