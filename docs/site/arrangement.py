"""How the pages are arranged, after Diátaxis: what the site's table of contents is made of.

The pages themselves are Markdown that knows nothing of it, so that it reads as well where it lies.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the table of contents.

    Args:
        caption: above its pages; none for pages that hang below another one.
        pages: by their names in ``docs/`` without ending, with another title than their own before a colon
            where that says more; a pattern with ``*`` stands for all that fit.
    """

    caption: str
    pages: Sequence[str]


# By the page that they are put under.
ARRANGEMENT: Mapping[str, Sequence[Section]] = {
    "index": (
        Section(
            "Tutorials",
            (
                "At a glance: site/readme",
                "plan-from-depth",
                "own-camera",
                "arm-in-space",
                "first-plan",
                "own-robot",
            ),
        ),
        Section(
            "How-to guides",
            (
                "workbench",
                "client",
                "integrations",
                "Bring data: data",
                "training",
                "Operate: operations",
                "Run in containers: containers",
                "Measure planners: benchmark",
                "extend",
            ),
        ),
        Section(
            "Reference",
            ("api", "site/openapi", "site/commands", "site/configuration", "site/python", "architecture"),
        ),
        Section(
            "Explanation",
            ("The method: method", "The paper: paper", "results", "security", "Decisions: adr/README"),
        ),
        Section("Gallery", ("gallery/index",)),
        Section(
            "The project",
            ("site/contributing", "site/security-policy", "site/changelog"),
        ),
    ),
    "results": (
        Section(
            "",
            tuple(
                f"results/{name}"
                for name in (
                    *(
                        "spatial",
                        "doctor",
                        "quality",
                        "planning",
                        "path-models",
                        "clusters",
                        "topology",
                        "paper",
                        "serving",
                    ),
                    *("attacks", "foreign-files", "scale", "measurements"),
                )
            ),
        ),
    ),
    "adr/README": (Section("", ("adr/0*",)),),
}


def contents(page: str) -> str:
    """The directives that put pages under a page, in MyST's Markdown; empty for a page without any.

    Args:
        page: its name.
    """
    return "".join(_directive(section) for section in ARRANGEMENT.get(page, ()))


def _directive(section: Section) -> str:
    options = [f":caption: {section.caption}", ":titlesonly:"] if section.caption else [":hidden:"]
    if any("*" in page for page in section.pages):
        options.append(":glob:")
    return "\n".join(["", "```{toctree}", *options, "", *map(_entry, section.pages), "```", ""])


def _entry(page: str) -> str:
    title, _, name = page.rpartition(": ")
    return f"{title} </{name}>" if title else f"/{name}"
