import os
import socket
from collections.abc import Iterator

import pytest

from cspace.errors import PortTakenError
from services.local.processes import free_ports, holder, is_free, require_free


@pytest.fixture
def taken() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield int(server.getsockname()[1])


def test_a_listener_on_all_addresses_takes_the_loopback_port_too() -> None:
    with socket.create_server(("", 0)) as server:
        assert not is_free(int(server.getsockname()[1]))


def test_a_port_is_free_again_after_its_connections_were_closed() -> None:
    server = socket.create_server(("127.0.0.1", 0))
    port = int(server.getsockname()[1])
    client = socket.create_connection(("127.0.0.1", port))
    connection, _ = server.accept()
    # The side that closes first keeps the port in TIME_WAIT.
    for one in (connection, client, server):
        one.close()
    assert is_free(port)


def test_the_error_for_a_taken_port_names_port_service_setting_and_holder(taken: int) -> None:
    with pytest.raises(PortTakenError) as raised:
        require_free(taken, "MLflow", "CSPACE_MLFLOW_PORT")
    message = str(raised.value)
    for part in (str(taken), "MLflow", "set CSPACE_MLFLOW_PORT", f"process {os.getpid()}"):
        assert part in message


def test_a_free_port_raises_nothing_and_has_no_holder() -> None:
    (port,) = free_ports(1)
    require_free(port, "MLflow", "CSPACE_MLFLOW_PORT")
    assert holder(port) is None
