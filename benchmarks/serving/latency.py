"""One client, one server on one core: the whole request beside the bare session calls, in the same run.

    python -m benchmarks.serving.latency --requests 200 --repeats 5

Server and bare sessions take turns on the same core, the client has another. Every picture is new, except
where the row says that it was sent before. The client is Python's own ``http.client`` over one kept
connection; the last row is the project's client.
"""

import argparse
import multiprocessing
import os
import statistics
import sys
import time
from collections.abc import Callable

import onnxruntime

from benchmarks.command import arguments
from benchmarks.machine import machine
from benchmarks.serving.served import BUNDLE, CLIENT_CORE, SERVER_CORE, Asker, new_pictures, served
from cspace.bundle import Bundle
from cspace.bundle.drawing.generated import expected_share
from cspace.bundle.draws import draw, propose
from cspace.bundle.keeping import gather
from cspace.worlds.planar.seeing.picture import decode_png
from services.evaluator.evaluation.tables import markdown
from services.planner.sources.sampling_client import SamplingClient

WARM_UP = 20


def bare_sessions(pngs: list[bytes], samples: int, core: int, answers) -> None:
    """Milliseconds of the graphs for each picture, by the sessions alone."""
    os.sched_setaffinity(0, {core})
    bundle = Bundle.load(BUNDLE)
    spec = bundle.spec
    encoder, generator, head = (session(f"{name}.onnx") for name in ("encoder", "generator", "validity"))
    known = session("novelty.onnx") if spec.novelty_quantiles else None
    answers.put("ready")
    for seed, png in enumerate(pngs):
        image, took = bundle.prepare(decode_png(png, spec.pixels)), []

        def run(session, names, feeds, took=took):
            began = time.perf_counter()
            found = session.run(names, feeds)
            took.append(1e3 * (time.perf_counter() - began))
            return found

        def scored(counts, turn, image=image, seed=seed, run=run):
            proposals, learned = propose(spec, counts, seed, turn), None
            if any(proposals.learned):
                encoding = image.encoding
                draws = draw(spec, encoding.mu, encoding.sigma, proposals.learned, seed, [0.0], turn)
                feeds = {"latent": draws.latents, "image": image.pixels, **draws.random_inputs}
                learned = run(generator, ["samples"], feeds)[0][:, 0]
            shown = proposals.mixed_with(learned)
            return shown, run(head, ["confidence"], {"image": image.pixels, "configurations": shown})[0]

        mu = run(encoder, ["mu"], {"image": image.pixels})[0]
        if known is not None:
            run(known, None, {"image": image.pixels, "mu": mu})
        gather(scored, [samples], spec.confidence_threshold, expected_share(spec))
        answers.put(sum(took))


def session(name: str) -> onnxruntime.InferenceSession:
    """A graph of the bundle on one thread."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return onnxruntime.InferenceSession(BUNDLE / name, options, providers=["CPUExecutionProvider"])


def timed(ask: Callable[[bytes], None], pngs: list[bytes]) -> float:
    """Median milliseconds of a request."""
    taken = []
    for png in pngs:
        began = time.perf_counter()
        ask(png)
        taken.append(1e3 * (time.perf_counter() - began))
    return statistics.median(taken)


def bare(pngs: list[bytes], samples: int) -> float:
    """Median of :func:`bare_sessions` in a process of its own."""
    context = multiprocessing.get_context("spawn")
    answers = context.Queue()
    worker = context.Process(target=bare_sessions, args=(pngs, samples, SERVER_CORE, answers))
    worker.start()
    answers.get()
    taken = [answers.get() for _ in pngs]
    worker.join()
    return statistics.median(taken[WARM_UP:])


def turns_parser(description: str) -> argparse.ArgumentParser:
    """Options of a benchmark whose rows take turns."""
    parser = arguments(description)
    parser.add_argument("--requests", type=int, default=200, help="a turn")
    parser.add_argument("--repeats", type=int, default=5, help="turns")
    parser.add_argument("--samples", type=int, default=300)
    return parser


def main() -> int:
    options = turns_parser(__doc__).parse_args()
    os.sched_setaffinity(0, {CLIENT_CORE % os.cpu_count()})
    # A picture for each request of each row and turn, so that none is known already.
    count = 3 * options.repeats * (options.requests + WARM_UP)
    pictures = iter(new_pictures(count))
    rows: dict[str, list[float]] = {}
    with served() as api, SamplingClient(f"http://127.0.0.1:{api.port}") as client:
        ask = Asker(api.port, options.samples)

        def note(name: str, pngs: list[bytes], question: Callable[[bytes], None]) -> None:
            for png in pngs[:WARM_UP]:
                question(png)
            rows.setdefault(name, []).append(timed(question, pngs[WARM_UP:]))

        for _ in range(options.repeats):
            fresh = [[next(pictures) for _ in range(options.requests + WARM_UP)] for _ in range(3)]
            rows.setdefault("bare sessions", []).append(bare(fresh[0], options.samples))
            note("npy, new picture", fresh[0], lambda png: ask(png, "application/x-npy"))
            known = fresh[0][:1] * len(fresh[0])
            note("npy, picture sent before", known, lambda png: ask(png, "application/x-npy"))
            note("JSON, new picture", fresh[1], lambda png: ask(png, "application/json"))
            note("the project's client", fresh[2], lambda png: client.sample(png, options.samples))
    table = [["", "median, ms", "range of turns", "over bare, ms", "of bare"]]
    base = rows["bare sessions"]
    for name, found in rows.items():
        over = statistics.median(a - b for a, b in zip(found, base, strict=True))
        times = statistics.median(a / b for a, b in zip(found, base, strict=True))
        spread = f"{min(found):.2f} to {max(found):.2f}"
        table.append([name, f"{statistics.median(found):.2f}", spread, f"{over:.2f}", f"{times:.2f}"])
    print(f"{machine()}\n\n{markdown(table)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
