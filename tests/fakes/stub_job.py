"""A job that only talks: progress, what its environment says, a result; with ``fail`` it ends badly."""

# ruff: noqa: T201

import json
import os
import sys
from pathlib import Path

NAMES = ("MLFLOW_TRACKING_URI", "CSPACE_DATA_DIR", "RAY_AUTH_MODE", "OMP_NUM_THREADS", "PYTHONPATH")


def main() -> int:
    """Print what a job would."""
    print("step 1 of 2", flush=True)
    fields = {name: os.environ.get(name) for name in NAMES}
    fields |= {"folder": str(Path.cwd()), "python": sys.executable}
    print("step 2 of 2", flush=True)
    if "fail" in sys.argv[1:]:
        print("the stub was told to fail", flush=True)
        return 1
    result = {"run_id": "r", "model": "stub", "version": 1, "digest": "d", "figures": []}
    print(f"RESULT {json.dumps(result | {'environment': fields})}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
