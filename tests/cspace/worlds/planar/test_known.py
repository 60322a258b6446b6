"""Known discs of the plane: checked as the exact checker does, and drawn as the renderer does."""

import json

import numpy as np
import pytest

from cspace.files import encode_png
from cspace.plan import Seen, search_paths
from cspace.query import PlanQuery
from cspace.view_file import pack_view
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK
from cspace.worlds.planar.collision import CollisionChecker, seen_checkers
from cspace.worlds.planar.simulator import render
from cspace.worlds.planar.world import Disc, KnownDiscs, PlanarWorld, Scenario

DISCS = (Disc(1.5, 1.0, 0.3), Disc(-2.0, 0.5, 0.8), Disc(0.3, -2.5, 0.05))
SHOWN = Disc(-3.0, -3.0, 1.0)


def text_of(discs):
    return json.dumps(
        {
            "scene": [
                {"name": f"disc {at}", "disc": {"x_m": one.x_m, "y_m": one.y_m, "radius_m": one.radius_m}}
                for at, one in enumerate(discs)
            ]
        }
    ).encode()


def known_discs(arm=TWO_LINK, discs=DISCS, shown=(SHOWN,)):
    return KnownDiscs.read(text_of(discs), arm, render(Scenario(arm, shown)))


@pytest.mark.parametrize("arm", [TWO_LINK, THREE_LINK])
def test_what_is_free_is_what_the_exact_checker_finds_clear_of_the_discs_alone(arm):
    rows = arm.space.sample_uniform(np.random.default_rng(1), 3000)
    known = known_discs(arm)
    clearance = CollisionChecker(Scenario(arm, DISCS)).clearance(rows)
    np.testing.assert_array_equal(known.free(rows), clearance > 0.0)
    assert 300 < (clearance <= 0.0).sum() < 2700
    for row, away in zip(rows[:300], clearance[:300], strict=True):
        contact = known.contact(row)
        if away > 0.0:
            assert contact is None
            continue
        assert contact.depth_m == pytest.approx(-away, abs=1e-12)
        disc = DISCS[int(contact.other.removeprefix("disc "))]
        place = np.asarray(contact.position_m[:2])
        gap = np.linalg.norm(place - (disc.x_m, disc.y_m)) - disc.radius_m - arm.half_width_m
        assert gap == pytest.approx(away, abs=1e-12)
        link = int(contact.link.removeprefix("link ")) - 1
        base, tip = arm.joint_positions_m(row)[0, link : link + 2]
        assert np.linalg.norm(place - base) + np.linalg.norm(tip - place) == pytest.approx(
            arm.link_lengths_m[link]
        )


def test_discs_are_drawn_as_the_renderer_draws_them():
    far = (Disc(3.3, 3.1, 0.7), Disc(-2.2, 2.9, 0.15), Disc(5.2, -4.7, 0.9))
    drawn = known_discs(discs=far).drawn(PlanarWorld().sensor).astype(int)
    exact = render(Scenario(TWO_LINK, (SHOWN, *far))).astype(int)
    assert np.abs(drawn - exact).max() <= 0.08 * 255
    assert np.abs(drawn - render(Scenario(TWO_LINK, (SHOWN,))))[..., 2].sum() > 255 * 50
    # Over the arm and over each other both round their edges differently.
    near = (Disc(1.5, 0.0, 0.3), Disc(-2.5, -2.5, 0.6))
    drawn = known_discs(discs=near).drawn(PlanarWorld().sensor).astype(int)
    assert np.abs(drawn - render(Scenario(TWO_LINK, (SHOWN, *near)))).mean() < 0.2


def test_the_search_keeps_known_discs_whole_and_those_of_the_picture_as_they_were():
    world, ends = PlanarWorld(), np.array([[0.5, 0.2], [2.0, -0.4]])
    # The first end is inside the first disc.
    tip = TWO_LINK.joint_positions_m(ends[:1])[0, -1]
    known = known_discs(discs=(Disc(*tip, 0.3), Disc(4.0, 4.0, 0.5)))
    plain = seen_checkers(world, known.seen, ends)
    both = seen_checkers(world, known.drawn(world.sensor), ends, known)
    for margin_m, before, after in zip((5 / 48, 0.0, 0.0), plain, both, strict=True):
        seen, added = np.split(after.scene.discs, [-2])
        np.testing.assert_array_equal(seen, before.scene.discs)
        np.testing.assert_allclose(added, [[*tip, 0.3], [4.0, 4.0, 0.5 + margin_m]])
        assert not after.valid(ends[0])


class ThinWall(KnownDiscs):
    """Stands where the first joint is 0 or pi, thinner than a search's steps."""

    def free(self, configurations, check_cancelled=lambda: None):
        del check_cancelled
        return np.abs(np.sin(configurations[:, 0])) > 0.006


def test_a_path_that_touches_what_is_known_between_the_states_of_the_search_is_no_answer():
    known = known_discs(discs=())
    ends = np.array([[-1.0, 0.2], [1.0, 0.2]])

    def found(what):
        seen = Seen(PlanarWorld(TWO_LINK), what.seen, lambda rows: (np.ones(len(rows)), None), known=what)
        return search_paths(seen, ends, PlanQuery(*map(tuple, ends), time_limit_s=60.0))

    assert found(known).paths
    blocked = found(ThinWall(known.arm, known.names, known.discs, known.seen))
    assert (blocked.paths, blocked.reason) == ([], "each path that was found touches a known body")


def view(**options):
    given = {"cameras": (), "state": None, "known": text_of(DISCS)} | options
    return pack_view([encode_png(render(Scenario(TWO_LINK, (SHOWN,))))], **given)
