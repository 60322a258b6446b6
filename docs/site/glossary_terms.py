"""The glossary's terms as entries of the index, so that a search leads to a term's own row."""

from collections import Counter
from collections.abc import Iterator

from docutils import nodes
from sphinx import addnodes
from sphinx.transforms import SphinxTransform

GLOSSARY = "glossary"


class MarkTerms(SphinxTransform):
    """Gives each term an anchor and an entry."""

    # Before Sphinx collects what belongs into the index.
    default_priority = 700

    def apply(self, **_: object) -> None:
        """Mark the first cell of every row."""
        if self.env.docname != GLOSSARY:
            return
        seen = Counter[str]()
        for body in list(self.document.findall(nodes.tbody)):
            for row in body.findall(nodes.row):
                for marker in reversed(list(_markers(row[0], seen))):
                    row[0].insert(0, marker)


def _markers(cell: nodes.Node, seen: Counter[str]) -> Iterator[nodes.Node]:
    for term in cell.astext().split(", "):
        anchor = nodes.make_id(f"term-{term}")
        # A word that means two things has two rows.
        seen[anchor] += 1
        if seen[anchor] > 1:
            anchor = f"{anchor}-{seen[anchor]}"
        yield addnodes.index(entries=[("single", term, anchor, "main", None)])
        yield nodes.target("", "", ids=[anchor])
