"""Who is next."""

from inference_api.scheduler import FairQueue


def order(queue: FairQueue[str]) -> list[str]:
    found = []
    while (item := queue.pop(lambda _: True)) is not None:
        found.append(item)
    return found


def test_one_clients_items_come_in_their_order() -> None:
    queue: FairQueue[str] = FairQueue()
    for item in ("a", "b", "c"):
        queue.push("one", 1.0, item)
    assert order(queue) == ["a", "b", "c"]


def test_the_first_item_of_another_client_does_not_wait_for_the_many_of_one() -> None:
    queue: FairQueue[str] = FairQueue()
    queue.begin("greedy", 1.0)
    for number in range(5):
        queue.push("greedy", 1.0, f"greedy {number}")
    queue.push("other", 1.0, "other 0")
    queue.push("other", 1.0, "other 1")
    assert order(queue)[:4] == ["other 0", "greedy 0", "other 1", "greedy 1"]


def test_what_costs_more_lets_more_of_the_others_go_first() -> None:
    queue: FairQueue[str] = FairQueue()
    for number in range(2):
        queue.push("dear", 4.0, f"dear {number}")
    for number in range(5):
        queue.push("cheap", 1.0, f"cheap {number}")
    assert order(queue) == ["dear 0", "cheap 0", "cheap 1", "cheap 2", "cheap 3", "dear 1", "cheap 4"]


def test_a_cost_that_is_found_out_later_counts_as_well() -> None:
    queue: FairQueue[str] = FairQueue()
    queue.begin("dear", 1.0)
    queue.charge("dear", 3.0)
    queue.push("dear", 1.0, "dear")
    for number in range(4):
        queue.push("cheap", 1.0, f"cheap {number}")
    assert order(queue) == ["cheap 0", "cheap 1", "cheap 2", "cheap 3", "dear"]


def test_a_client_that_was_away_has_saved_nothing_up() -> None:
    queue: FairQueue[str] = FairQueue()
    for _ in range(100):
        queue.begin("busy", 1.0)
    for number in range(2):
        queue.push("back", 1.0, f"back {number}")
        queue.push("busy", 1.0, f"busy {number}")
    assert order(queue) == ["back 0", "busy 0", "back 1", "busy 1"]


def test_what_does_not_fit_stays() -> None:
    queue: FairQueue[str] = FairQueue()
    queue.push("one", 1.0, "long")
    queue.push("one", 1.0, "short")
    assert queue.pop(lambda item: item == "short") == "short"
    assert queue.pop(lambda item: item == "short") is None
    assert len(queue) == 1


def test_what_is_taken_out_is_not_given_out() -> None:
    queue: FairQueue[str] = FairQueue()
    first, second = "a", "b"
    queue.push("one", 1.0, first)
    queue.push("one", 1.0, second)
    assert queue.discard(first)
    assert not queue.discard(first)
    assert order(queue) == ["b"]


def test_clients_that_are_not_ahead_are_forgotten() -> None:
    queue: FairQueue[str] = FairQueue(capacity=10)
    for number in range(1000):
        queue.begin(f"client {number}", 1.0)
        # The clock goes on with what begins later.
        queue.begin("clock", 1.0)
    assert len(queue._ends) <= 12
