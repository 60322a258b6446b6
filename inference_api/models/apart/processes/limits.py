"""What a child process may take of the machine; the kernel holds it to that."""

import resource
import signal
from pathlib import Path

# Beyond what it holds with its libraries imported, for lists and downloads. Bundles run elsewhere.
MEMORY_BYTES = 512 * 2**20
FILE_BYTES = 600 * 2**20
OPEN_FILES = 256
# A child ends itself this much after its parent should have ended it.
GRACE_S = 2.0


def limit_resources(memory_bytes: int = MEMORY_BYTES) -> None:
    """Bound address space, file size and open files of this process, for good; no core files.

    Args:
        memory_bytes: address space beyond what is taken now.
    """
    _lower(resource.RLIMIT_AS, _address_space_bytes() + memory_bytes)
    _lower(resource.RLIMIT_FSIZE, FILE_BYTES)
    _lower(resource.RLIMIT_NOFILE, OPEN_FILES)
    _lower(resource.RLIMIT_CORE, 0)


def own_signals() -> None:
    """Ctrl-C is the parent's to handle; the timer's signal ends this process, whatever was inherited."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})


def limit_time(limit_s: float) -> None:
    """End this process ``limit_s`` and a grace from now, even inside a library; 0 takes that back."""
    signal.setitimer(signal.ITIMER_REAL, limit_s + GRACE_S if limit_s else 0.0)


def _lower(kind: int, value: int) -> None:
    _, hard = resource.getrlimit(kind)
    if hard != resource.RLIM_INFINITY:
        value = min(value, hard)
    resource.setrlimit(kind, (value, value))


def _address_space_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
