"""Where a sampler's own time went, from the answer's header and from a bundle in this process."""

import pytest

from cspace.png import encode_png
from cspace_client.answers import read_timing
from services.planner.samples import LocalSampler, SourceTiming
from tests.bundles import picture, write_tiny_bundle


def test_the_header_is_read_in_seconds_whatever_stands_beside():
    header = "cdn;desc=edge, decode;dur=0.250, encode;dur=1.5, generate;dur=10, total;dur=12.000"
    assert read_timing(header) == SourceTiming(0.00025, 0.0015, 0.01, 0.012)


@pytest.mark.parametrize(
    "header",
    [
        "",
        "total;dur=12",
        "decode;dur=0, encode;dur=x, generate;dur=1, total;dur=2",
        "decode;dur=0, encode;dur=-1, generate;dur=1, total;dur=2",
        "decode;dur=nan, encode;dur=1, generate;dur=1, total;dur=2",
        "decode, encode, generate, total",
    ],
)
def test_a_header_that_does_not_tell_is_no_error(header):
    assert read_timing(header) is None


def test_a_bundle_in_this_process_tells_its_parts_and_takes_no_other_time(tmp_path):
    batch = LocalSampler(write_tiny_bundle(tmp_path / "bundle")).sample(encode_png(picture()), 10, seed=1)
    timing = batch.timing
    assert min(timing.decode_s, timing.encode_s, timing.generate_s) > 0.0
    assert timing.decode_s + timing.encode_s + timing.generate_s <= timing.total_s == batch.round_trip_s
