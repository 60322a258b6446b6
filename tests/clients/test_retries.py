import math
from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cspace_client.errors import ConfigError
from cspace_client.transport import RetryPolicy, parse_retry_after

POLICY = RetryPolicy(attempts=4, base_s=0.1, cap_s=0.3, deadline_s=10.0)
NOW = datetime(2025, 3, 1, 12, 0, 0, tzinfo=UTC)


def test_the_bound_of_the_pause_doubles_up_to_the_cap() -> None:
    assert [POLICY.pause_s(tried, 0.0, None, 0.5) for tried in (1, 2, 3)] == pytest.approx([0.05, 0.1, 0.15])


def test_the_last_attempt_is_the_last() -> None:
    assert POLICY.pause_s(3, 0.0, None, 0.0) == 0.0
    assert POLICY.pause_s(4, 0.0, None, 0.0) is None
    assert RetryPolicy(attempts=1).pause_s(1, 0.0, None, 0.0) is None


def test_the_server_s_wish_is_waited_for_within_the_deadline() -> None:
    assert POLICY.pause_s(1, 0.0, 7.0, 0.9) == 7.0
    assert POLICY.pause_s(1, 0.0, 0.01, 0.9) == pytest.approx(0.09)
    assert POLICY.pause_s(1, 3.0, 7.0, 0.9) is None
    assert POLICY.pause_s(1, 9.99, None, 0.9) is None
    assert POLICY.pause_s(1, 0.0, math.inf, 0.9) is None


@given(
    st.integers(1, 5000), st.floats(0, 100), st.none() | st.floats(0, 100), st.floats(0, 1, exclude_max=True)
)
def test_no_pause_leads_past_the_deadline_or_below_the_server_s_wish(
    tried: int, spent_s: float, retry_after_s: float | None, draw: float
) -> None:
    policy = RetryPolicy(attempts=5001, base_s=0.2, cap_s=5.0, deadline_s=50.0)
    pause = policy.pause_s(tried, spent_s, retry_after_s, draw)
    if pause is None:
        assert spent_s + max(5.0, retry_after_s or 0.0) >= 50.0
    else:
        assert spent_s + pause < 50.0
        assert pause >= (retry_after_s or 0.0)
        assert pause < 5.0 or pause == retry_after_s


WAITS = [
    ("0", 0.0),
    (" 120 ", 120.0),
    ("Sat, 01 Mar 2025 12:00:30 GMT", 30.0),
    ("Sat, 01 Mar 2025 11:00:00 GMT", 0.0),
    ("Sat, 01 Mar 2025 12:00:05 -0000", 5.0),
    (None, None),
    ("", None),
    ("-1", None),
    ("1.5", None),
    ("soon", None),
    ("²", None),
    ("9" * 9, 999_999_999.0),
    ("9" * 10, math.inf),
    ("9" * 5000, math.inf),
    ("Sat, 01 Mar " + "9" * 20 + " 12:00:00 GMT", None),
    ("Sat, 01 Mar 2025 12:00:00 +999999999999", None),
    ("Sat, 01 Mar 9999 12:00:00 -2359", 251_635_161_540.0),
    ("Sat, 01 Mar 2025 12:00:30 GMT" + " " * 80 + "(why)", None),
]


def test_retry_after_is_seconds_or_a_date() -> None:
    for value, expected in WAITS:
        assert parse_retry_after(value, NOW) == expected, value


@given(st.text(max_size=40))
def test_no_text_of_a_header_breaks_the_reader(text: str) -> None:
    found = parse_retry_after(text, NOW)
    assert found is None or found >= 0.0


@pytest.mark.parametrize(
    "values", [{"attempts": 0}, {"base_s": 0.0}, {"cap_s": -1.0}, {"deadline_s": float("inf")}], ids=str
)
def test_a_policy_that_can_not_be_is_named(values: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="retries"):
        RetryPolicy(**values)
