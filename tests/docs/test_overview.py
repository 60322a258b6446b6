import runpy
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cspace.worlds.planar.camera import decode_png
from tests.bundles import write_tiny_bundle
from tests.docs.blocks import ROOT
from tests.space_bundle import write_space_bundle

SCRIPT = ROOT / "docs" / "make_overview.py"


def test_the_overview_is_drawn_from_a_bundle_and_shows_the_scenario_of_the_documents(tmp_path: Path) -> None:
    bundle = write_tiny_bundle(tmp_path / "bundle")
    main = runpy.run_path(str(SCRIPT))["main"]
    assert main(["--bundle", str(bundle), "--folder", str(tmp_path)]) == 0
    with Image.open(tmp_path / "overview.png") as drawn:
        assert drawn.width > 2 * drawn.height
        assert len(np.unique(np.asarray(drawn.convert("L")))) > 20
    made, kept = (
        decode_png((folder / "scenario.png").read_bytes()) for folder in (tmp_path, ROOT / "docs" / "images")
    )
    assert np.array_equal(made, kept)


def test_a_missing_bundle_is_told_and_nothing_is_drawn(tmp_path: Path) -> None:
    main = runpy.run_path(str(SCRIPT))["main"]
    assert main(["--bundle", str(tmp_path / "gone"), "--folder", str(tmp_path)]) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_picture_of_space_is_drawn_from_a_bundle(tmp_path: Path) -> None:
    bundle = write_space_bundle(tmp_path / "bundle")
    main = runpy.run_path(str(SCRIPT.with_name("make_space_overview.py")))["main"]
    assert main(["--bundle", str(bundle), "--folder", str(tmp_path)]) == 0
    with Image.open(tmp_path / "space.png") as drawn:
        assert drawn.width > 2 * drawn.height
        assert len(np.unique(np.asarray(drawn.convert("L")))) > 20
    assert main(["--bundle", str(tmp_path / "gone"), "--folder", str(tmp_path)]) == 1
