"""Two bundles of the same weights in one process: what their graphs take, and how far their answers differ.

    python -m benchmarks.serving.exported_anew BEFORE AFTER --requests 300

Each picture goes to one and then to the other, the first of the two changing. Counted is the process's time
on its processor, which other programs of the machine disturb less than a clock; the least of all requests
and their quartiles are told. The whole of a request is what a bundle does in the same process: a picture
prepared, and samples filtered at the bundle's threshold, without a server.
"""

import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime

from benchmarks.command import arguments
from benchmarks.machine import machine
from benchmarks.serving.served import new_pictures
from cspace.bundle import Bundle
from cspace.bundle.draws import draw, propose
from cspace.bundle.keeping import EXTRA
from cspace.worlds.planar.seeing.picture import decode_png
from services.evaluator.evaluation.tables import markdown

WARM_UP = 20


class Measured:
    """A bundle, its two sessions that every sample costs, and what they took.

    Args:
        folder: of the bundle.
        samples: a request.
    """

    def __init__(self, folder: Path, samples: int) -> None:
        self.bundle, self.samples = Bundle.load(folder), samples
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self.generator, self.head = (
            onnxruntime.InferenceSession(folder / name, options, providers=["CPUExecutionProvider"])
            for name in ("generator.onnx", "validity.onnx")
        )
        self.took: dict[str, list[float]] = defaultdict(list)

    def ask(self, image: np.ndarray, seed: int) -> np.ndarray:
        """The samples of a request, each part of it timed."""
        spec = self.bundle.spec
        picture = self.timed("a picture prepared", lambda: self.bundle.prepare(image))
        found = self.timed("samples of it", lambda: self.bundle.sample(picture, self.samples, seed))
        rows = int(np.ceil(self.samples * (1 + EXTRA) / (1.0 - spec.uniform_share / 2.0)))
        proposals = propose(spec, [rows], seed, 0)
        draws = draw(spec, picture.encoding.mu, picture.encoding.sigma, proposals.learned, seed, [0.0])
        feeds = {"latent": draws.latents, "image": picture.pixels, **draws.random_inputs}
        (drawn,) = self.timed("session: generator", lambda: self.generator.run(["samples"], feeds))
        shown = {"image": picture.pixels, "configurations": proposals.mixed_with(drawn[:, 0])}
        self.timed("session: validity head", lambda: self.head.run(["confidence"], shown))
        return found.samples

    def timed(self, name: str, run: Callable):
        began = time.process_time()
        found = run()
        self.took[name].append(1e3 * (time.process_time() - began))
        return found


def row(name: str, before: list[float], after: list[float]) -> list[str]:
    ratios = np.array(after) / np.array(before)
    told = [
        f"{min(took):.2f} ({np.quantile(took, 0.25):.2f}, {np.median(took):.2f})" for took in (before, after)
    ]
    return [name, *told, f"{min(after) / min(before):.2f}", f"{np.median(ratios):.2f}"]


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("before", type=Path, help="a bundle's folder")
    parser.add_argument("after", type=Path, help="that of the same exported anew")
    parser.add_argument("--requests", type=int, default=300, help="each of a picture of its own")
    parser.add_argument("--samples", type=int, default=300)
    options = parser.parse_args()
    both = [Measured(folder, options.samples) for folder in (options.before, options.after)]
    apart, others = 0.0, 0
    for turn, png in enumerate(new_pictures(options.requests + WARM_UP)):
        image = decode_png(png, both[0].bundle.spec.pixels)
        answers = {}
        for which in (0, 1) if turn % 2 else (1, 0):
            answers[which] = both[which].ask(image, turn)
        gap = np.abs(both[0].bundle.spec.world.space.difference(answers[0], answers[1])).max(axis=1)
        # A sample that only one of them has moves all behind it, and is no matter of rounding.
        others += bool((gap > 1e-3).any())
        apart = max(apart, float(gap.max(where=gap <= 1e-3, initial=0.0)))
    table = [["", "before, ms: least (quartile, median)", "after", "of the least", "median ratio"]]
    for name, before in both[0].took.items():
        table.append(row(name, before[WARM_UP:], both[1].took[name][WARM_UP:]))
    print(f"{machine()}\n\n{markdown(table)}")
    print(f"samples differ by {apart:.1e} rad at most; {others} requests with other samples")
    return 0


if __name__ == "__main__":
    sys.exit(main())
