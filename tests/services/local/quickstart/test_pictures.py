from pathlib import Path

import httpx
import pytest

from cspace.errors import RegistryError
from services.local.jobs import fetch_pictures


def server(request: httpx.Request) -> httpx.Response:
    known = request.url.path == "/get-artifact" and request.url.params["path"] == "figures/losses.png"
    return httpx.Response(200, content=b"png") if known else httpx.Response(404)


@pytest.mark.parametrize("name", ["losses", "losses.png", "../../losses.png"])
def test_a_figure_is_copied_by_its_name_into_the_folder(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "figures"
    found = fetch_pictures("http://mlflow", "r1", [name], folder, httpx.MockTransport(server))
    assert found == [folder / "losses.png"]
    assert found[0].read_bytes() == b"png"


def test_a_figure_that_is_not_there_is_an_error_that_names_it(tmp_path: Path) -> None:
    with pytest.raises(RegistryError, match=r"figures/other\.png of run r1"):
        fetch_pictures("http://mlflow", "r1", ["other"], tmp_path, httpx.MockTransport(server))
