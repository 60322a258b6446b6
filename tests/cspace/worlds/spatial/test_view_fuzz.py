"""A thousand mutants of :mod:`tests.cspace.worlds.spatial.view_fuzz`, a hundredth of what was tried once."""

import pytest

from tests.cspace.worlds.spatial.view_fuzz import Subject, run


@pytest.mark.slow
def test_whatever_is_changed_is_answered_or_refused_and_nothing_is_surer_for_knowing_less() -> None:
    found = run(Subject(), 0, 1000)
    assert sum(found.values()) == 1000
    assert {name: times for name, times in found.items() if name.endswith("surer")} == {}
    assert min(found[name] for name in ("rows answered", "rows refused", "files refused")) > 20
