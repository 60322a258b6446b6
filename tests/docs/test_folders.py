"""What docs/architecture.md says of folders, counted."""

from collections import Counter

from tests.docs.blocks import ROOT

SOURCE = ("cspace", "clients", "training", "services", "inference_api", "benchmarks")


def test_a_folder_has_at_most_fifteen_modules() -> None:
    modules = [path for top in SOURCE for path in (ROOT / top).rglob("*.py") if path.name != "__init__.py"]
    counted = Counter(str(path.parent.relative_to(ROOT)) for path in modules)
    assert len(counted) > 40
    assert {folder: count for folder, count in counted.items() if count > 15} == {}


def test_every_package_says_what_it_is_for() -> None:
    doors = [path for top in SOURCE for path in (ROOT / top).rglob("__init__.py")]
    silent = [path for path in doors if not path.read_text(encoding="utf-8").startswith('"""')]
    assert [str(path.parent.relative_to(ROOT)) for path in silent] == []
