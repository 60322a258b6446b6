"""A Ray cluster of several nodes on this machine, for tests of what goes where."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[3]
LOOPBACK = "127.0.0.1"
WORKERS_SEE = {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


@contextmanager
def ray_nodes(nodes: Sequence[Mapping[str, Any]]) -> Iterator[list[str]]:
    """One node for each entry with what it offers, the head first; yields their ids, and ends them all."""
    import ray
    from ray._common import utils as common
    from ray._private import services, utils
    from ray.cluster_utils import Cluster

    from training.jobs.launch import QUIET

    with pytest.MonkeyPatch.context() as patch:
        for name, value in {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "disabled", **QUIET}.items():
            patch.setenv(name, value)
        patch.delenv("RAY_ADDRESS", raising=False)
        patch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
        # A driver would replace the address by one of the machine, where none of the nodes listens.
        patch.setattr(services, "resolve_ip_for_localhost", lambda host: host)
        # Nor does a driver of another test look for a cluster here.
        patch.setattr(utils, "write_ray_address", lambda address, temp_dir=None: None)
        patch.setattr(common, "reset_ray_address", lambda temp_dir=None: None)
        # A test before may have left a Ray of its own.
        ray.shutdown()
        cluster = Cluster()
        try:
            ids = [
                cluster.add_node(
                    node_ip_address=LOOPBACK,
                    include_dashboard=False,
                    include_log_monitor=False,
                    object_store_memory=100 * 2**20,
                    **offered,
                ).node_id
                for offered in nodes
            ]
            ray.init(
                address=cluster.address,
                _node_ip_address=LOOPBACK,
                log_to_driver=False,
                logging_level="warning",
                runtime_env={"env_vars": WORKERS_SEE},
            )
            yield ids
        finally:
            ray.shutdown()
            cluster.shutdown()
