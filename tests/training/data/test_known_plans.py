"""Plans whose pictures were kept: which ends are known, and what they say of configurations."""

from pathlib import Path
from typing import Any

import numpy as np

from cspace.space import circles
from services.outcomes import Spool, upload, view_row
from tests.bundles import holds
from tests.fakes.registry import FakeTracking
from training.data.outcomes import KnownPlan, known_plans

SPACE = circles(2)
PATH = np.array([[3.0, 0.0], [-2.2832, 0.0], [-2.2832, 0.5]])


def view(number: int, robot: str = "a", keep_s: float = 60.0) -> dict[str, Any]:
    row = view_row("m/3", robot, b"picture %d" % number, PATH, keep_s)
    return {"request_id": f"r{number}", "client": "one", **row}


def end(number: int, **more: Any) -> dict[str, Any]:
    row = {"kind": "plan", "request_id": f"r{number}", "model": "m/3", "client": "one", "success": False}
    return row | more


def uploaded(folder: Path, *batches: list[dict[str, Any]]) -> FakeTracking:
    tracking = FakeTracking()
    for rows in batches:
        spool = Spool(folder, 2**28, lambda *_: None)
        assert all(spool.add([row]) for row in rows)
        list(upload(folder, tracking))
    return tracking


def test_only_plans_whose_end_is_known_are_known(tmp_path: Path) -> None:
    ends = [
        end(0, collided=False),
        end(1, collided=True, collided_at=0.4, site="lab"),
        end(2, collided=True),
        end(3),
        end(4, success=True),
        end(5, collided=False, client="two"),
        end(7, collided=False),
    ]
    rows = [view(number) for number in range(7)] + [view(7, robot="b")]
    tracking = uploaded(tmp_path, rows, ends)
    found = {one.image: one.collided_at for one in known_plans(tracking, "a")}
    assert found == {b"picture 0": None, b"picture 1": 0.4, b"picture 4": None}
    assert [one.image for one in known_plans(tracking, "a", "lab")] == [b"picture 1"]
    [other] = known_plans(tracking, "b")
    np.testing.assert_array_equal(other.path, PATH)


def test_a_path_is_free_up_to_where_it_collides() -> None:
    free, collision = KnownPlan(b"", PATH, None, "run").labelled(SPACE)
    # 1.5 rad, a row for each tenth; the first piece leads over the seam of the circle.
    assert (len(free), len(collision)) == (16, 0)
    np.testing.assert_allclose(free[0], PATH[0], atol=1e-6)
    np.testing.assert_allclose(free[-1], PATH[-1], atol=1e-4)
    assert holds(SPACE, free)
    free, collision = KnownPlan(b"", PATH, 0.8, "run").labelled(SPACE)
    np.testing.assert_allclose(collision, [[-2.2832, 0.2]], atol=1e-3)
    assert len(free) == 11
    reached = SPACE.distance(free[-1], np.array([-2.2832, 0.0]))
    assert reached <= 0.101
    free, collision = KnownPlan(b"", PATH, 0.0, "run").labelled(SPACE)
    assert (len(free), len(collision)) == (0, 1)
    np.testing.assert_allclose(collision[0], PATH[0], atol=1e-6)


def test_a_fifth_of_pictures_is_held_out_with_all_their_plans() -> None:
    plans = [KnownPlan(b"%d" % number, PATH, None, "run") for number in range(400)]
    assert 50 <= sum(one.held_out for one in plans) <= 110
    again = [KnownPlan(one.image, PATH[::-1], 0.5, "other") for one in plans]
    assert [one.held_out for one in again] == [one.held_out for one in plans]
