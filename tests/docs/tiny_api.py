"""Inference APIs for the examples that need one, started when the first of them asks.

One has a tiny model, and the other the shipped ones, for the pages in :data:`SHIPPED`.
"""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.bundles import write_tiny_bundle
from tests.inference_api.server import api_server

DOCUMENTED = "http://127.0.0.1:8000"
SHIPPED = ("plan-from-depth.md",)


class TinyApi:
    """Real servers; :meth:`address` starts them."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self._folder, self._stack = folder, stack
        self._addresses: dict[bool, str] = {}

    def address(self, page: str | Path) -> str:
        """Where the API of a page's examples listens."""
        shipped = Path(page).name in SHIPPED
        if shipped not in self._addresses:
            folder, settings = self._folder / str(shipped), {}
            folder.mkdir()
            if not shipped:
                bundle = write_tiny_bundle(folder / "bundle", validity=True)
                settings = {"CSPACE_PRETRAINED_MODEL": str(bundle)}
            self._addresses[shipped] = self._stack.enter_context(api_server(folder, settings))
        return self._addresses[shipped]


@pytest.fixture(scope="session")
def tiny_api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TinyApi]:
    """The lazy servers of this session."""
    with ExitStack() as stack:
        yield TinyApi(tmp_path_factory.mktemp("docs-api"), stack)
