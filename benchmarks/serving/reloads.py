"""Promotions under load: two versions take turns as champion while clients go on asking.

    python -m benchmarks.serving.reloads --out build/reloads --reloads 250

A real MLflow store, the real server with its poll, two clients without a pause. Reported: requests,
failures, versions seen, and the slope of resident memory over reloads with its 95 % interval.
"""

import os
import sys
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import stats

from benchmarks.command import arguments
from benchmarks.machine import machine
from benchmarks.serving.served import BUNDLE, Asker, new_pictures, served
from cspace.bundle import Bundle, Provenance, write_bundle
from cspace.files import make_output_folder
from services.names import ALIAS_CHAMPION, EXPERIMENT, MODEL_NAME
from services.registry.mlflow_registry import MlflowRegistry
from services.registry.mlflow_tracking import MlflowTracking

GRAPHS = ("encoder", "generator", "validity", "novelty")
# The first reloads fill caches and pools.
SETTLED = 50
PATIENCE_S = 30.0


def two_versions(uri: str, folder: Path) -> MlflowRegistry:
    """The shipped bundle and a twin of another digest as versions 1 and 2."""
    first = Bundle.load(BUNDLE)
    files = {name: BUNDLE / f"{name}.onnx" for name in GRAPHS}
    graphs = {name: path.read_bytes() for name, path in files.items() if path.is_file()}
    twin = replace(first.spec, provenance=Provenance(command="a twin"))
    registry = MlflowRegistry(uri)
    with MlflowTracking(uri).start(EXPERIMENT, "reloads") as run:
        for bundle in (first, Bundle.load(write_bundle(folder / "twin", twin, graphs))):
            registry.register(MODEL_NAME, bundle.folder, run.run_id, bundle.digest, {})
    registry.set_alias(MODEL_NAME, ALIAS_CHAMPION, 1)
    return registry


class Load:
    """Clients that ask without a pause until they are told to stop."""

    def __init__(self, port: int, clients: int) -> None:
        self.stopped, self.failures, self.answers = threading.Event(), [], 0
        self.version, self.pictures = "", new_pictures(64)
        self.threads = [threading.Thread(target=self._ask, args=(port, i)) for i in range(clients)]
        for thread in self.threads:
            thread.start()

    def _ask(self, port: int, number: int) -> None:
        ask = Asker(port, 100)
        while not self.stopped.is_set():
            try:
                answer = ask(self.pictures[(self.answers + number) % len(self.pictures)])
            except Exception as error:  # noqa: BLE001 - whatever it is, it counts
                self.failures.append(repr(error))
                ask = Asker(port, 100)
            else:
                self.answers += 1
                self.version = answer.headers["X-Model-Version"]

    def end(self) -> None:
        """Wait for the last answers."""
        self.stopped.set()
        for thread in self.threads:
            thread.join()


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--reloads", type=int, default=250)
    parser.add_argument("--clients", type=int, default=2)
    options = parser.parse_args()
    options.out = options.out.resolve()
    make_output_folder(options.out)
    folder = Path(tempfile.mkdtemp(dir=options.out.resolve()))
    # MLflow puts the artifacts of a store without a server below the working folder.
    os.chdir(folder)
    uri = f"sqlite:///{folder / 'mlflow.db'}"
    registry = two_versions(uri, folder)
    settings = {"MLFLOW_TRACKING_URI": uri, "CSPACE_MODEL_POLL_S": "0.05"}
    # One bundle beside champion and shipped one, so that each reload reads its version from the disk.
    settings |= {"CSPACE_MODEL_CACHE": str(folder / "cache"), "CSPACE_LOADED_MODELS": "1"}
    memory, waits = [], []
    with served(settings) as api:
        load = Load(api.port, options.clients)
        for turn in range(options.reloads):
            wanted = 2 - turn % 2
            registry.set_alias(MODEL_NAME, ALIAS_CHAMPION, wanted)
            began = time.monotonic()
            while load.version != str(wanted) and time.monotonic() - began < PATIENCE_S:
                time.sleep(0.01)
            waits.append(time.monotonic() - began)
            memory.append(api.resident_kib)
        load.end()
    late = sum(wait >= PATIENCE_S for wait in waits)
    line = stats.linregress(np.arange(SETTLED, len(memory)), memory[SETTLED:])
    margin = line.stderr * stats.t.ppf(0.975, max(1, len(memory) - SETTLED - 2))
    print(machine())
    print(f"{len(waits)} reloads, {late} of them not seen; served after {np.median(waits):.2f} s (median)")
    print(f"{load.answers} answers, {len(load.failures)} failures {load.failures[:3]}")
    (options.out / "memory.txt").write_text("\n".join(map(str, memory)))
    print(f"resident memory {memory[0] / 1024:.0f} to {memory[-1] / 1024:.0f} MiB, after {SETTLED} reloads")
    print(f"{line.slope:+.1f} KiB a reload [{line.slope - margin:+.1f}, {line.slope + margin:+.1f}]")
    return 1 if load.failures or late else 0


if __name__ == "__main__":
    sys.exit(main())
