"""The most memory that a command's workers have taken."""

import subprocess
import sys

_CODE = """
import resource, runpy, sys
name, sys.argv = sys.argv[1], sys.argv[1:]
try:
    runpy.run_module(name, run_name="__main__", alter_sys=True)
finally:
    print("PEAK", 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def worker_peak(module: str, *arguments: str) -> tuple[subprocess.CompletedProcess[str], int]:
    """The ended command ``python -m MODULE ...``, and the resident size in bytes of its largest worker.

    In a process of its own, for a test's process has had other children.
    """
    command = [sys.executable, "-c", _CODE, module, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done, int(done.stdout.rpartition("PEAK ")[2])
