"""An inference API with a tiny model for the examples that need one, started when the first of them asks."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.bundles import write_tiny_bundle
from tests.inference_api.server import api_server

DOCUMENTED = "http://127.0.0.1:8000"


class TinyApi:
    """A real server over the tiny bundle as its shipped model; :attr:`address` starts it."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self._folder, self._stack = folder, stack
        self._address: str | None = None

    @property
    def address(self) -> str:
        """Where it listens."""
        if self._address is None:
            bundle = write_tiny_bundle(self._folder / "bundle", validity=True)
            settings = {"CSPACE_PRETRAINED_MODEL": str(bundle)}
            self._address = self._stack.enter_context(api_server(self._folder, settings))
        return self._address


@pytest.fixture(scope="session")
def tiny_api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TinyApi]:
    """The lazy server of this session."""
    with ExitStack() as stack:
        yield TinyApi(tmp_path_factory.mktemp("docs-api"), stack)
