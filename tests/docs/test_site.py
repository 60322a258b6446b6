"""What the documentation site is made of, without building it."""

import re
from pathlib import Path
from types import ModuleType

import pytest

from tests.docs.blocks import ROOT
from tests.docs.site_modules import SITE, site_module

DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def outside() -> ModuleType:
    return site_module("outside")


@pytest.fixture(scope="module")
def command_lines() -> ModuleType:
    return site_module("command_lines")


def arranged() -> list[str]:
    sections = [one for found in site_module("arrangement").ARRANGEMENT.values() for one in found]
    return [page.rpartition(": ")[2] for section in sections for page in section.pages]


def test_every_page_has_one_place_in_the_table_of_contents() -> None:
    places = arranged()
    patterns = [place for place in places if "*" in place]
    pages = {str(path.relative_to(DOCS).with_suffix("")) for path in DOCS.rglob("*.md")}
    matched = {page for page in pages for pattern in patterns if Path(page).match(pattern)}
    assert sorted(places) == sorted(set(places))
    assert pages - set(places) - matched == {"index"}


def test_every_place_is_a_page_that_is_there_or_is_made() -> None:
    missing = [
        place
        for place in arranged()
        if "*" not in place
        and not any((DOCS / f"{place}{ending}").is_file() for ending in (".md", ".myst", ".rst"))
    ]
    # Made of the examples when the site is built.
    assert set(missing) <= {"gallery/index"}
    assert (DOCS / "examples" / "README.rst").is_file()


def test_the_contents_of_a_page_are_directives_of_its_sections() -> None:
    contents = site_module("arrangement").contents
    assert contents("method") == ""
    text = contents("index")
    assert re.findall(r":caption: (.*)", text)[:4] == [
        "Tutorials",
        "How-to guides",
        "Reference",
        "Explanation",
    ]
    assert "\nOperate </operations>\n" in text
    assert ":hidden:" in contents("results")


def test_pages_of_the_root_are_shown_with_links_that_hold_on_the_site(outside: ModuleType) -> None:
    readme = outside.text_of("site/readme", "")
    assert readme.startswith("# cspace-sampler")
    targets = re.findall(r"\]\(([^)#\s]+)", re.sub(r"```.*?```", "", readme, flags=re.DOTALL))
    inner = [target for target in targets if "://" not in target]
    assert "contributing.myst" in inner
    assert [target for target in inner if not (SITE / target).exists()] == []


def test_a_link_to_a_document_of_the_root_leads_to_its_page(outside: ModuleType) -> None:
    text = "[a](../README.md#start) [b](method.md) `[c](../README.md)` [d](https://site.example/README.md)"
    assert outside.text_of("operations", text) == text.replace(
        "[a](../README.md#start)", "[a](site/readme.myst#start)"
    )
    assert outside.text_of("results/paper", "[a](../../SECURITY.md)") == "[a](../site/security-policy.myst)"


def test_a_link_that_shows_a_files_name_shows_its_title_on_the_site(outside: ModuleType) -> None:
    assert outside.text_of("index", "[data.md](data.md#the-folder)") == "[](data.md#the-folder)"
    assert outside.text_of("index", "[adr](adr/README.md)") == "[adr](adr/README.md)"
    assert outside.text_of("index", "![data.png](data.png)") == "![data.png](data.png)"


def test_the_page_of_commands_has_every_command_of_the_project(command_lines: ModuleType) -> None:
    documented = {command.line for command in command_lines.COMMANDS}
    mains = [*ROOT.glob("services/*/__main__.py"), *ROOT.glob("training/*/__main__.py"),
             ROOT / "inference_api" / "__main__.py"]  # fmt: skip
    lines = {f"python -m {'.'.join(path.parent.relative_to(ROOT).parts)}" for path in mains}
    assert len(lines) > 6
    assert lines - documented == set()
    jobs = [
        path.stem for path in ROOT.glob("training/*.py") if "__main__" in path.read_text(encoding="utf-8")
    ]
    assert len(jobs) > 6
    assert [job for job in jobs
            if not {f"python training/{job}.py", f"python -m training.{job}"} & documented] == []  # fmt: skip


def test_a_command_is_told_as_it_tells_itself(command_lines: ModuleType) -> None:
    server = next(command for command in command_lines.COMMANDS if command.line.endswith("inference_api"))
    assert "--allow-unauthenticated" in command_lines.parser_of(server).format_help()
    silent = command_lines.Command("python -m nothing", "json", "dumps")
    with pytest.raises(LookupError, match="parses no command line"):
        command_lines.parser_of(silent)
