"""The sender of outcomes: what it sends, and that a planner never waits for it."""

import json
import threading
import time
from dataclasses import replace

import httpx
import numpy as np
import pytest
from pydantic import ValidationError

from cspace_client import FoundPlan, ModelInfo, OutcomeSender, SampleBatch
from cspace_client import outcomes as module
from cspace_client.wire import ScenarioInfo

BATCH = SampleBatch(np.zeros((0, 2), np.float32), "m", 1, "f" * 64, 7, 0, 0.1, request_id="r-2")
FOUND = FoundPlan.model_construct(
    model=ModelInfo(name="m", version=1, digest="f" * 64),
    scenario=ScenarioInfo(novelty=0.5),
    confidence=0.25,
    receipt="signed",
    request_id="r-1",
)


class Server:
    """Answers with these statuses, one after the other and the last for good; None hangs up."""

    def __init__(self, *statuses):
        self.statuses, self.bodies, self.headers = list(statuses), [], []

    def __call__(self, request):
        self.bodies.append(json.loads(request.read())["outcomes"])
        self.headers.append(request.headers)
        status = self.statuses.pop(0) if len(self.statuses) > 1 else self.statuses[0]
        if status is None:
            raise httpx.ConnectError("nobody listens")
        return httpx.Response(status, json={"kept": 1})

    def sender(self, **options):
        return OutcomeSender("http://test:1", transport=httpx.MockTransport(self), **options)


def test_outcomes_are_sent_in_batches_with_the_key_and_what_the_answer_says():
    server = Server(202)
    with server.sender(api_key="csk_mine") as sender:
        for number in range(1500):
            sender.samples(BATCH, checked=np.int64(number), free=0, site="cell-4")
        sender.plan(FOUND, success=np.False_, collided=True, collided_at=np.float32(0.5))
        sender.samples(replace(BATCH, request_id=None), checked=3, free=2)
    told = [one for body in server.bodies for one in body]
    assert max(map(len, server.bodies)) <= 1000
    assert [one["checked"] for one in told[:-1]] == list(range(1500))
    common = {"model": "m/1", "stamp_s": told[-1]["stamp_s"]}
    plan = {"request_id": "r-1", "receipt": "signed", "novelty": 0.5, "confidence": 0.25, "success": False}
    assert told[-1] == common | plan | {"kind": "plan", "collided": True, "collided_at": 0.5}
    samples = {"kind": "samples", "request_id": "r-2", "checked": 0, "free": 0, "site": "cell-4"}
    assert told[0] == common | samples | {"stamp_s": told[0]["stamp_s"]}
    assert server.headers[0]["authorization"] == "Bearer csk_mine"
    assert (sender.sent, sender.dropped) == (1501, 0)


def test_what_no_server_takes_is_an_error_at_once():
    with Server(202).sender() as sender:
        for wrong in ({"collided_at": 0.5}, {"time_s": -1.0}, {"x": 1}):
            with pytest.raises(ValidationError):
                sender.plan(FOUND, success=True, **wrong)
        for checked, free, site in ((3, 4, None), (20_001, 1, None), (3, 2, "cell 4")):
            with pytest.raises(ValidationError):
                sender.samples(BATCH, checked=checked, free=free, site=site)


@pytest.mark.parametrize(
    ("statuses", "requests", "sent"), [((None, 503, 202), 3, 1), ((503,), 4, 0), ((404,), 1, 0)]
)
def test_a_server_that_may_answer_later_is_asked_again_and_others_are_not(statuses, requests, sent):
    server = Server(*statuses)
    with server.sender() as sender:
        sender.plan(FOUND, success=True)
    assert len(server.bodies) == requests
    assert (sender.sent, sender.dropped) == (sent, 1 - sent)


def test_a_server_that_hangs_holds_up_neither_the_planner_nor_for_long_the_end():
    asked, release = threading.Event(), threading.Event()

    def hang(request):
        asked.set()
        release.wait(60.0)
        raise httpx.ReadTimeout("at last")

    sender = OutcomeSender("http://test:1", transport=httpx.MockTransport(hang))
    sender.plan(FOUND, success=True)
    assert asked.wait(60.0)
    began = time.monotonic()
    for _ in range(module.MAX_WAITING + 5):
        sender.plan(FOUND, success=True)
    assert sender.dropped == 5
    sender.close()
    assert time.monotonic() - began < 30.0
    release.set()
