from services.registry.tracking.parameters import MAX_NAME, MAX_VALUE, flatten


def test_nesting_becomes_dots_and_values_become_text() -> None:
    params = {"preset": "quickstart", "vae": {"latent": 64, "train": {"rate": 1e-3}}, "gpu": None, "on": True}
    assert flatten(params) == {
        "preset": "quickstart",
        "vae.latent": "64",
        "vae.train.rate": "0.001",
        "gpu": "None",
        "on": "True",
    }


def test_sequences_are_json_and_an_empty_mapping_is_kept() -> None:
    assert flatten({"betas": (0, 0.9), "extra": {}, "paths": [{"a": 1}]}) == {
        "betas": "[0, 0.9]",
        "extra": "{}",
        "paths": '[{"a": 1}]',
    }


def test_a_value_of_the_longest_length_stays_and_a_longer_one_ends_in_dots() -> None:
    kept = flatten({"fits": "x" * MAX_VALUE, "long": "x" * (MAX_VALUE + 1)})
    assert kept["fits"] == "x" * MAX_VALUE
    assert kept["long"] == "x" * (MAX_VALUE - 3) + "..."


def test_names_hold_only_what_mlflow_takes() -> None:
    assert list(flatten({"rate [1/s]": 1})) == ["rate _1/s_"]
    assert [len(name) for name in flatten({"n" * 300: 1})] == [MAX_NAME]
