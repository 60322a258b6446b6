"""Reference pages that are made of the code itself, in Markdown, when the site is built."""

from collections.abc import Callable, Mapping

import command_lines
import configuration_page
import openapi_page

GENERATED: Mapping[str, Callable[[], str]] = {
    "site/commands": command_lines.markdown,
    "site/configuration": configuration_page.markdown,
    "site/openapi": openapi_page.markdown,
}
