"""Attributes of configurations in a data set: clearance and origin."""

import numpy as np
import pytest

from cspace.dataset import open_dataset, write_dataset
from cspace.errors import DatasetError
from tests.dataset_content import content


def attribute(name, change=lambda values: values):
    """One array for all scenarios of the content, changed."""
    rows, what = name.split("_")
    parts = content()[rows]
    sign = 1.0 if rows == "free" else -1.0
    made = [
        np.full(len(part), 2, np.uint8) if what == "origin" else sign * np.linspace(0.1, 0.2, len(part))
        for part in parts
    ]
    return {name: [change(values) for values in made]}


@pytest.mark.parametrize("name", ["free_origin", "collision_clearance"])
def test_it_is_read_back_by_scenario(tmp_path, name):
    given = attribute(name)
    write_dataset(tmp_path / "data", **content(), attributes=given)
    dataset = open_dataset(tmp_path / "data")
    assert dataset.attributes == (name,)
    for scenario, values in enumerate(given[name]):
        np.testing.assert_allclose(dataset.attribute_of(name, scenario), values, rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("free_clearance", lambda values: values[1:], "does not fit"),
        ("free_clearance", lambda values: -values, "above 0 where free"),
        ("collision_clearance", lambda values: -values, "above 0 where free"),
        ("free_origin", lambda values: values + 5, "below 5"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, name, change, message):
    with pytest.raises(DatasetError, match=message):
        write_dataset(tmp_path / "data", **content(), attributes=attribute(name, change))
    assert list(tmp_path.iterdir()) == []
