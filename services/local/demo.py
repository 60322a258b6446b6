"""The workbench on what ships: the API alone, without a registry and without any training."""

import os
import webbrowser
from collections.abc import Callable, Mapping

from services.local.servers.api_server import api_server
from services.local.servers.stack import up
from services.local.settings import Settings

# Of a desktop, or what somebody set for the purpose; browsers of a terminal would take it over.
_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


def demo(
    settings: Settings,
    say: Callable[[str], None],
    *,
    browser: bool,
    environment: Mapping[str, str] = os.environ,
    open_page: Callable[[str], object] = webbrowser.open,
) -> None:
    """Start the API where it does not run, print the page's address, and open it.

    Args:
        settings: of the services.
        say: takes lines for people.
        browser: whether a browser is wanted.
        environment: that tells whether there is a screen.
        open_page: opens an address.

    Raises:
        PortTakenError: a stranger listens on the API's port.
        ServiceError: the API belongs to another checkout.
        ServiceStartError: it did not come up.
    """
    up(settings, (api_server(settings),), say)
    page = f"{settings.api_url}/"
    say(f"\nthe workbench   {page}\n\nIt stays up; `make down` ends it.")
    if browser and any(environment.get(name) for name in _SCREENS):
        open_page(page)
