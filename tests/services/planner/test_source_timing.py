"""Where the time of a bundle in this process went."""

from cspace.png import encode_png
from services.planner.samples import LocalSampler
from tests.bundles import picture, write_tiny_bundle


def test_a_bundle_in_this_process_tells_its_parts_and_takes_no_other_time(tmp_path):
    batch = LocalSampler(write_tiny_bundle(tmp_path / "bundle")).sample(encode_png(picture()), 10, seed=1)
    timing = batch.timing
    assert min(timing.decode_s, timing.encode_s, timing.generate_s) > 0.0
    assert timing.decode_s + timing.encode_s + timing.generate_s <= timing.total_s == batch.round_trip_s
