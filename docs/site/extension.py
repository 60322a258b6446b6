"""What the site adds to Sphinx: contents, pages of the root, and pages that are made of the code itself."""

from typing import Any

from arrangement import contents
from generated import GENERATED
from outside import text_of
from sphinx.application import Sphinx


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("source-read", _read)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


def _read(app: Sphinx, page: str, source: list[str]) -> None:
    if page in GENERATED:
        source[0] = GENERATED[page]()
    elif app.env.doc2path(page).suffix in {".md", ".myst"}:
        source[0] = text_of(page, source[0]) + contents(page)
