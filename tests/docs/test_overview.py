import runpy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cspace.worlds.planar.camera import decode_png
from tests.bundles import write_tiny_bundle
from tests.docs.blocks import ROOT
from tests.space_bundle import write_space_bundle

DOCS = ROOT / "docs"


@pytest.mark.parametrize(
    ("script", "write", "picture"),
    [
        ("make_overview.py", write_tiny_bundle, "overview.png"),
        pytest.param("make_space_overview.py", write_space_bundle, "space.png", marks=pytest.mark.slow),
    ],
)
def test_an_overview_is_drawn_from_a_bundle_and_not_without_one(
    tmp_path: Path, script: str, write: Callable[[Path], Path], picture: str
) -> None:
    main, out = runpy.run_path(str(DOCS / script))["main"], tmp_path / "out"
    out.mkdir()
    assert main(["--bundle", str(tmp_path / "gone"), "--folder", str(out)]) == 1
    assert list(out.iterdir()) == []
    assert main(["--bundle", str(write(tmp_path / "bundle")), "--folder", str(out)]) == 0
    with Image.open(out / picture) as drawn:
        assert drawn.width > 2 * drawn.height
        assert len(np.unique(np.asarray(drawn.convert("L")))) > 20
    if picture == "overview.png":
        made, kept = (decode_png((folder / "scenario.png").read_bytes()) for folder in (out, DOCS / "images"))
        assert np.array_equal(made, kept)
