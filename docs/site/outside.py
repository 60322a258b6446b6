"""Pages of the project's root as pages of the site, and links to and from them.

A page such as ``docs/site/readme.myst`` is empty: the text of ``README.md`` is put in when it is read, and
links are led to where their targets lie on the site. A link that shows a file's name shows its title there.
"""

import os
import re
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).parents[2]
DOCS = PurePosixPath("docs")
# The page of the site that shows a document of the root.
SHOWN: Mapping[str, str] = {
    "README.md": "site/readme.myst",
    "CONTRIBUTING.md": "site/contributing.myst",
    "SECURITY.md": "site/security-policy.myst",
    "CHANGELOG.md": "site/changelog.myst",
}
_SOURCE = {page.removesuffix(".myst"): name for name, page in SHOWN.items()}
_LINK = re.compile(r"\[(?P<text>[^\]]*)\]\((?P<target>[^)#\s]+)(?P<anchor>(?:#[^)\s]*)?)\)")
_CODE = re.compile(r"(```.*?```|`[^`\n]*`)", re.DOTALL)


def text_of(page: str, text: str) -> str:
    """What a page shows: its own text or that of a document of the root, with links that hold on the site.

    Args:
        page: its name in ``docs/``, without ending.
        text: its own.
    """
    document = _SOURCE.get(page)
    if document is not None:
        text = (ROOT / document).read_text(encoding="utf-8")
    lies = PurePosixPath(document) if document else DOCS / f"{page}.md"
    shown = PurePosixPath(f"{page}.md")
    parts = _CODE.split(text)
    parts[::2] = [_LINK.sub(lambda link: _led(link, lies, shown), part) for part in parts[::2]]
    return "".join(parts)


def _led(link: re.Match[str], lies: PurePosixPath, shown: PurePosixPath) -> str:
    if re.match(r"[a-z]+:", link["target"]):
        return link[0]
    target = PurePosixPath(os.path.normpath(lies.parent / link["target"]))
    # Files outside docs/ that are no pages become downloads.
    found = SHOWN.get(str(target)) or os.path.relpath(target, DOCS)
    # MyST puts the title of the page, or of the heading, where there is no text.
    text = "" if target.suffix == ".md" and PurePosixPath(link["text"]).name == target.name else link["text"]
    return f"[{text}]({os.path.relpath(found, shown.parent)}{link['anchor']})"
