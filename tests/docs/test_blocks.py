import json
from pathlib import Path

import pytest
from sybil import Document
from sybil.parsers.markdown import CodeBlockParser

from tests.docs.blocks import OF_SHELL, ROOT, Block, Kind, all_blocks, blocks, documents


def test_every_block_is_of_a_known_kind() -> None:
    assert [block.name for block in all_blocks() if block.kind is None] == []


def test_every_mark_stands_right_above_a_shell_block() -> None:
    found = {
        (path, number)
        for path in documents()
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if line.lstrip().startswith("<!-- run:")
    }
    used = {(block.document, block.line - 1) for block in all_blocks(*OF_SHELL)}
    assert found == used


def test_the_documents_hold_blocks_of_every_kind() -> None:
    assert {block.kind for block in all_blocks()} == set(Kind)


@pytest.mark.parametrize("document", documents(), ids=lambda path: str(path.relative_to(ROOT)))
def test_sybil_finds_the_python_blocks_that_are_listed(document: Path) -> None:
    parsed = Document.parse(str(document), CodeBlockParser("python", lambda _: None))
    found = [str(example.parsed) for example in parsed.examples()]
    assert found == [block.source for block in blocks(document) if block.kind is Kind.PYTHON]


@pytest.mark.parametrize("block", all_blocks(Kind.JSON), ids=lambda block: block.name)
def test_json_blocks_are_json(block: Block) -> None:
    assert json.loads(block.source) is not None


@pytest.mark.parametrize("block", all_blocks(Kind.ELSEWHERE), ids=lambda block: block.name)
def test_the_test_that_is_named_holds_the_words_that_are_named(block: Block) -> None:
    name, _, words = block.rest.partition(" words: ")
    text = (ROOT / name).read_text(encoding="utf-8")
    assert words
    assert [word for word in words.split() if word not in text or word not in block.source] == []


@pytest.mark.parametrize("block", all_blocks(Kind.STACK), ids=lambda block: block.name)
def test_a_block_against_all_services_is_slow_or_says_nothing(block: Block) -> None:
    assert block.rest in {"", "slow"}


def test_blocks_without_a_mark_or_in_an_unknown_language_are_of_no_kind(tmp_path: Path) -> None:
    document = tmp_path / "page.md"
    shell, unknown = "```bash\nrm -r nothing\n```\n", "```\nwhat is this\n```\n"
    document.write_text(f"{shell}{unknown}\n<!-- run: api -->\n```python\n1\n```\n", encoding="utf-8")
    assert [block.kind for block in blocks(document)] == [None, None, None]


def test_a_block_that_does_not_end_is_an_error(tmp_path: Path) -> None:
    document = tmp_path / "page.md"
    document.write_text("```bash\nls\n", encoding="utf-8")
    with pytest.raises(ValueError, match="line 1"):
        blocks(document)
