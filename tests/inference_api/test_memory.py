import sys

import pytest

from inference_api.memory import few_arenas


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc")
def test_the_c_library_takes_the_bound() -> None:
    assert few_arenas()
