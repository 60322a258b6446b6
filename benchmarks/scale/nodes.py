"""A Ray cluster of many nodes on this machine, on loopback only, and what it takes of memory."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import psutil
import ray
from ray._common import utils as common
from ray._private import services, utils
from ray.cluster_utils import Cluster

from benchmarks.machine import ROOT
from training.trials.launch import QUIET

LOOPBACK = "127.0.0.1"
STORE_BYTES = 80 * 2**20


@contextmanager
def many_nodes(count: int) -> Iterator[Cluster]:
    """So many nodes of one slot each; the head is one of them."""
    os.environ.pop("RAY_ADDRESS", None)
    os.environ |= QUIET
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    # A driver would replace the address by one of the machine, where none of the nodes listens.
    services.resolve_ip_for_localhost = lambda host: host
    # Nor does anybody else's driver look for a cluster here.
    utils.write_ray_address = common.reset_ray_address = _tell_nobody
    cluster = Cluster()
    try:
        for _ in range(count):
            cluster.add_node(
                num_cpus=1,
                node_ip_address=LOOPBACK,
                include_dashboard=False,
                include_log_monitor=False,
                object_store_memory=STORE_BYTES,
            )
        ray.init(
            address=cluster.address,
            _node_ip_address=LOOPBACK,
            log_to_driver=False,
            logging_level="warning",
            runtime_env={"env_vars": {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", **QUIET}},
        )
        yield cluster
    finally:
        ray.shutdown()
        cluster.shutdown()


def _tell_nobody(*_: object) -> None:
    pass


def memory_bytes() -> int:
    """Of this process and all that it started, what they share counted once."""
    total = 0
    for process in [psutil.Process(), *psutil.Process().children(recursive=True)]:
        try:
            total += process.memory_full_info().pss
        except psutil.Error:
            continue
    return total


def free_bytes() -> int:
    """What the machine still has."""
    return int(psutil.virtual_memory().available)
