"""Attributes of configurations in a data set: clearance and origin."""

import numpy as np
import pytest

from cspace.dataset import ATTRIBUTES, open_dataset, write_dataset
from tests.dataset_content import content


def attribute(name):
    """One array for all scenarios of the content."""
    rows, what = name.split("_")
    parts = content()[rows]
    sign = 1.0 if rows == "free" else -1.0
    made = [
        np.full(len(part), 2, np.uint8) if what == "origin" else sign * np.linspace(0.1, 0.2, len(part))
        for part in parts
    ]
    return {name: made}


@pytest.mark.parametrize("name", ["free_origin", "collision_clearance"])
def test_it_is_read_back_by_scenario(tmp_path, name):
    given = attribute(name)
    write_dataset(tmp_path / "data", **content(), attributes=given)
    dataset = open_dataset(tmp_path / "data")
    assert ATTRIBUTES.keys() & dataset.arrays.keys() == {name}
    offsets = dataset.arrays[f"{name.partition('_')[0]}_offsets"]
    for values, found in zip(given[name], np.split(dataset.arrays[name], offsets[1:-1]), strict=True):
        np.testing.assert_allclose(found, values, rtol=1e-6)
