"""The API with a watch on each step; what ``stages.py`` starts.

    python -m benchmarks.serving.timed_server RECORDS --port 0

Writes one JSON object a request of ``POST /sample``, step to seconds, when it ends.
"""

import atexit
import json
import sys
from pathlib import Path

import inference_api.__main__ as command
from benchmarks.command import arguments
from benchmarks.serving import spans
from cspace.bundle import Bundle
from cspace.bundle.drawing import generated
from cspace.bundle.running import graphs
from cspace.bundle.running.sessions import Session
from cspace.worlds.planar.world import PlanarWorld
from inference_api import app
from inference_api.pages import sample as routes
from inference_api.pages import sampling
from inference_api.turns import turns

# The steps by name, as ``stages.py`` tells them.
MIDDLEWARE, FORM, HAND_OVER, REST = "middleware, log, metrics", "form", "hand-over to the thread", "the rest"
CHECKS, DECODE, RANDOM, WRITE = "checks of the request", "PNG decoding", "random numbers", "writing"
AROUND = "around the sessions"
SESSIONS = {
    name: f"session: {name}" for name in ("encoder.onnx", "novelty.onnx", "generator.onnx", "validity.onnx")
}
STEPS = (
    *SESSIONS.values(),
    AROUND,
    RANDOM,
    DECODE,
    CHECKS,
    WRITE,
    REST,
    HAND_OVER,
    FORM,
    MIDDLEWARE,
)


def watch_steps() -> None:
    """Put a watch on the functions that a request goes through."""
    spans.wrap_coroutine(routes, "read_fields", FORM)
    spans.wrap_coroutine(turns.Turns, "run", HAND_OVER)
    spans.wrap(turns.Turn, "compute", REST)
    for name in ("parse_fields", "validate_request"):
        spans.wrap(sampling, name, CHECKS)
    spans.wrap(PlanarWorld, "read_picture", DECODE)
    for name in ("prepare", "answer"):
        spans.wrap(Bundle, name, AROUND)
    for name in ("draw", "propose"):
        spans.wrap(generated, name, RANDOM)
    spans.wrap(sampling, "npy_response", WRITE)
    watch_sessions()


def watch_sessions() -> None:
    """The runs of each graph by its name, which the session itself does not know."""
    names: dict[int, str] = {}
    opened = graphs.Graph.__init__

    def open_named(graph, name, *arguments, **named):
        opened(graph, name, *arguments, **named)
        names[id(graph._session)] = SESSIONS.get(name, AROUND)  # noqa: SLF001 - which one it is, no more

    graphs.Graph.__init__ = open_named
    run = Session.run

    def run_named(session, *arguments):
        # Before a graph is open its session is tried, for no request.
        with spans.step(names.get(id(session), AROUND)):
            return run(session, *arguments)

    Session.run = run_named


def watch_requests(records: list[dict[str, float]]) -> None:
    """Keep the steps of each request that asks for samples."""
    create = app.create_app

    def create_watched():
        inner = create()

        async def watched(scope, receive, send):
            if scope.get("path") != "/sample":
                return await inner(scope, receive, send)
            found = spans.Spans()
            spans.request.set(found)
            try:
                with spans.step(MIDDLEWARE):
                    return await inner(scope, receive, send)
            finally:
                records.append(found.own)
                spans.request.set(None)

        watched.state = inner.state
        return watched

    app.create_app = create_watched


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("records", type=Path, help="file to write; what follows is the API's")
    options, others = parser.parse_known_args()
    records: list[dict[str, float]] = []
    watch_steps()
    watch_requests(records)
    atexit.register(lambda: options.records.write_text("\n".join(json.dumps(one) for one in records)))
    return command.main(others)


if __name__ == "__main__":
    sys.exit(main())
