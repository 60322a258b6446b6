"""The modules of ``docs/site``, which are the site's own and no package."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from tests.docs.blocks import ROOT

SITE = ROOT / "docs" / "site"


def site_module(name: str) -> ModuleType:
    """A module of the site by its name, loaded again."""
    path: Path = SITE / f"{name}.py"
    spec = importlib.util.spec_from_file_location(f"docs_site_{name}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up.
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
