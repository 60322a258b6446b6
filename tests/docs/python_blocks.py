"""Python blocks of the documents as pytest items, by Sybil. The blocks of a document share their names."""

import os
from pathlib import Path

from sybil import Example, Sybil
from sybil.evaluators.python import PythonEvaluator, pad
from sybil.parsers.markdown import CodeBlockParser

from tests.docs.blocks import ROOT
from tests.docs.tiny_api import DOCUMENTED, TinyApi


class BlockEvaluator(PythonEvaluator):
    """Runs a block in a scratch folder; the documented address of the API becomes that of the tiny one."""

    def __call__(self, example: Example) -> None:
        source = str(example.parsed)
        if DOCUMENTED in source:
            api: TinyApi = example.namespace["tiny_api"]
            source = source.replace(DOCUMENTED, api.address(example.path))
        code = compile(pad(source, example.line + example.parsed.line_offset), example.path, "exec")
        scratch: Path = example.namespace["docs_scratch"]
        here = Path.cwd()
        os.chdir(scratch)
        try:
            exec(code, example.namespace)  # noqa: S102 - the documents are the project's own
        finally:
            os.chdir(here)


def sybil() -> Sybil:
    """The parser of ``README.md`` and ``docs/``."""
    return Sybil(
        parsers=[CodeBlockParser("python", BlockEvaluator())],
        path=str(ROOT),
        patterns=["README.md", "docs/*.md", "docs/*/*.md"],
        excludes=["tests/*/*.md"],
        fixtures=["docs_scratch", "tiny_api"],
    )
