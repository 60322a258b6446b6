"""Pictures of a run, copied from the tracking server into the state folder."""

from collections.abc import Sequence
from pathlib import Path

import httpx

from cspace.errors import RegistryError

# Where the tracking adapter puts figures within a run.
RUN_FOLDER = "figures"


def fetch_pictures(
    url: str, run_id: str, names: Sequence[str], folder: Path, transport: httpx.BaseTransport | None = None
) -> list[Path]:
    """Copy a run's figures by name; the files.

    Args:
        url: of the tracking server.
        run_id: whose figures.
        names: with or without ``.png``.
        folder: that the files go to; made if it is not there.
        transport: of httpx; None for the network.

    Raises:
        RegistryError: a figure is not there, or the server does not answer.
    """
    folder.mkdir(parents=True, exist_ok=True)
    found = []
    with httpx.Client(base_url=url, timeout=30.0, trust_env=False, transport=transport) as client:
        for name in names:
            # A name is a run's word, not a path of this machine.
            file = f"{Path(name).name.removesuffix('.png')}.png"
            found.append(folder / file)
            found[-1].write_bytes(_download(client, run_id, f"{RUN_FOLDER}/{file}"))
    return found


def _download(client: httpx.Client, run_id: str, path: str) -> bytes:
    try:
        answer = client.get("/get-artifact", params={"run_uuid": run_id, "path": path}).raise_for_status()
    except httpx.HTTPError as error:
        raise RegistryError(f"the figure {path} of run {run_id} cannot be fetched", got=str(error)) from error
    return answer.content
