"""The glossary's terms as entries of the index, so that a search leads to a term's own row."""

from collections import Counter

from docutils import nodes
from sphinx import addnodes
from sphinx.transforms import SphinxTransform

GLOSSARY = "glossary"


class MarkTerms(SphinxTransform):
    """Gives each row an anchor and its terms their entries."""

    # Before Sphinx collects what belongs into the index.
    default_priority = 700

    def apply(self, **_: object) -> None:
        """Mark every row."""
        if self.env.docname != GLOSSARY:
            return
        seen = Counter[str]()
        for body in self.document.findall(nodes.tbody):
            for row in body.findall(nodes.row):
                _mark(row, seen)


def _mark(row: nodes.Element, seen: Counter[str]) -> None:
    words = row[0].astext()
    anchor = nodes.make_id(f"term-{words}")
    # A word that means two things has two rows.
    seen[anchor] += 1
    if seen[anchor] > 1:
        anchor = f"{anchor}-{seen[anchor]}"
    # On the row, for the search shows the text of what it leads to.
    row["ids"].append(anchor)
    entries = [("single", word, anchor, "main", None) for word in words.split(", ")]
    row[0].insert(0, addnodes.index(entries=entries))
