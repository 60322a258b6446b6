import pytest

from cspace.errors import ConfigError
from training.config.clusters import load_config
from training.sweeps.grid import axis, points


def test_every_combination_is_a_point_and_the_last_axis_varies_fastest():
    found = points([axis("clusters.count=[1, 2]"), axis("seed=[0, 1, 2]")])
    assert [point.title for point in found] == [
        f"clusters.count={count}, seed={seed}" for count in (1, 2) for seed in (0, 1, 2)
    ]


def test_a_point_has_the_same_key_however_its_axes_are_ordered_and_others_have_others():
    one = points([axis("clusters.count=[1, 2]"), axis("seed=[0, 1]")])
    other = points([axis("seed=[1, 0]"), axis("clusters.count=[2, 1]")])
    assert {point.key for point in one} == {point.key for point in other}
    assert len({point.key for point in one}) == 4


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("global.smooth_maximum=[null, 0.1]", (None, 0.1)),
        ("local.generator_lookups=[{points_per_link: 3}, {points_per_link: 6}]", (3, 6)),
        ("global.generator_learning_rate=[1e-5, 0.0003]", (1e-5, 3e-4)),
    ],
)
def test_values_of_any_kind_reach_the_configuration(text, values):
    found = [load_config("quickstart", point.overrides) for point in points([axis(text)])]
    section, key = text.partition("=")[0].split(".")
    took = [getattr(config.global_ if section == "global" else config.local, key) for config in found]
    assert tuple(getattr(value, "points_per_link", value) for value in took) == values
    assert len(set(points([axis(text)]))) == len(values)


@pytest.mark.parametrize(
    "text", ["seed", "seed=", "seed=1", "seed=[]", "=[1]", "seed=[1, 1]", "seed=[1", "seed={a: 1}"]
)
def test_what_is_no_axis_is_an_error_that_shows_one(text):
    with pytest.raises(ConfigError, match=r"VALUE|different values"):
        axis(text)


@pytest.mark.parametrize("texts", [[], ["seed=[1]", "seed=[2]"]])
def test_a_grid_needs_axes_with_keys_of_their_own(texts):
    with pytest.raises(ConfigError, match="each with a key of its own"):
        points([axis(text) for text in texts])
