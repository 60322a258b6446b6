"""The learned samplers of a benchmark: models behind an API, or bundles in the process; each one pinned."""

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from cspace.bundle.verification import load_verified
from cspace.errors import ConfigError, SamplerError, SamplerUnavailableError
from cspace.problem import UNIFORM, Problem
from cspace.query import SampleQuery
from cspace.splits import Split
from cspace.view_file import is_view, pack_view, unpack_view
from cspace.world import World
from cspace.worlds import picture_file_of, robot_digest, workshop_of
from services.evaluator.measures.scenes import PackedBundle
from services.planner.planning import between_ends
from services.planner.sources.local_sampler import LocalSampler
from services.planner.sources.samples import SampleBatch, SampleSource
from services.planner.sources.sampling_client import SamplingClient

_END = struct.pack(">I", 0) + b"IEND" + struct.pack(">I", zlib.crc32(b"IEND"))


def fresh_picture(file: bytes, note: str) -> bytes:
    """:func:`fresh_png` of a PNG file, or of the first picture of a view.

    Raises:
        ValueError: a picture does not end as a PNG file does.
        ImageError: the view is none.
    """
    if not is_view(file):
        return fresh_png(file, note)
    view = unpack_view(file)
    pictures = [fresh_png(view.pictures[0], note), *view.pictures[1:]]
    return pack_view(pictures, view.cameras, view.state, view.depth_scale_m)


def fresh_png(png: bytes, note: str) -> bytes:
    """A PNG file with a note in front of its end; the pixels stay the same.

    Raises:
        ValueError: the bytes do not end as a PNG file does.
    """
    if not png.endswith(_END):
        raise ValueError("a PNG file ends with an empty IEND chunk")
    content = b"tEXtComment\0" + note.encode("latin-1")
    chunk = struct.pack(">I", len(content) - 4) + content + struct.pack(">I", zlib.crc32(content))
    return png.removesuffix(_END) + chunk + _END


@dataclass(frozen=True, slots=True)
class SourceSpec:
    """Where samples come from, with all that a worker process needs to ask for them.

    Args:
        name: in the names of arms.
        digest: of the bundle that has to answer.
        with_ends: whether start and goal are sent, as path models require and others refuse.
        model: reference at the API, pinned to a version; None for a bundle.
        url: of the API; None for a bundle.
        packed: the bundle's files; None for a model behind an API.
    """

    name: str
    digest: str
    with_ends: bool
    model: str | None = None
    url: str | None = None
    packed: PackedBundle | None = None

    @property
    def described(self) -> dict[str, object]:
        """For manifest and report."""
        over = "HTTP" if self.url is not None else "none: a bundle in the planner's process"
        return {"model": self.model, "digest": self.digest, "with_ends": self.with_ends, "transport": over}


def served(name: str, model: str, url: str, world: World) -> SourceSpec:
    """A model behind an API, pinned to the version that answers now.

    Args:
        name: in the names of arms.
        model: a reference.
        url: of the API.
        world: whose robot is planned for.

    Raises:
        SamplerError: the API refuses, or does not answer.
    """
    with SamplingClient(url) as client:
        with_ends, batch = _first_answer(client, model, world)
    # The shipped model has no number in a registry.
    pinned = f"{batch.model_name}/{batch.model_version}" if batch.model_version else batch.model_name
    return SourceSpec(name, batch.digest, with_ends, pinned, url)


def bundled(name: str, folder: Path) -> SourceSpec:
    """A bundle that answers in the planner's own process.

    Raises:
        BundleError: it is damaged.
    """
    bundle = load_verified(folder)
    return SourceSpec(name, bundle.digest, bundle.spec.kind == "path", packed=PackedBundle.pack(bundle))


@contextmanager
def opened(specs: Sequence[SourceSpec], world: World) -> Iterator[Mapping[str, SampleSource]]:
    """The sources by name, each of them asked once, so that no first run pays for what only a first one has.

    Args:
        specs: the samplers.
        world: whose robot is planned for.

    Raises:
        SamplerError: one of them does not answer.
        BundleError: a bundle is damaged.
    """
    with ExitStack() as stack:
        found: dict[str, SampleSource] = {}
        for spec in specs:
            found[spec.name] = _opened(spec, stack)
            ask(found[spec.name], spec, _example(world), SampleQuery(10, 1, min_confidence=0.0))
        yield found


def ask(source: SampleSource, spec: SourceSpec, problem: Problem, query: SampleQuery) -> SampleBatch:
    """One batch for a problem's picture, as for a picture that was never sent before.

    Raises:
        SamplerUnavailableError: the source does not answer.
        SamplerError: it refused, for it is of another robot or for another reason, or another model answered
            than the one that is measured.
    """
    query = replace(query, robot=robot_digest(problem.scenario.world))
    note = f"{query.seed} {query.n} {query.epsilon_sigma} {query.min_confidence}"
    picture = fresh_picture(picture_file_of(problem.scenario), note)
    batch = source.answer(picture, between_ends(query, problem) if spec.with_ends else query, spec.model)
    if batch.digest != spec.digest:
        raise SamplerError(
            f"another model answers for {spec.name}", expected=spec.digest[:12], got=batch.digest[:12]
        )
    return batch


def mixed(samples: NDArray[np.float32], seed: int) -> NDArray[np.float32]:
    """Samples (n, d) in an order of chance, the same one for the same seed."""
    return np.random.default_rng([seed, 3]).permutation(samples)


def parse_named(text: str) -> tuple[str, str]:
    """``NAME=VALUE``, or a value that is its own name up to its version.

    Raises:
        ConfigError: a part is empty.
    """
    name, separator, value = text.partition("=")
    if not separator:
        name, value = text.partition("@")[0].partition("/")[0], text
    if not name or not value or "," in name:
        raise ConfigError(
            "the sampler has no proper name", expected="NAME=VALUE without a comma", got=repr(text)
        )
    return name, value


def _first_answer(client: SamplingClient, model: str, world: World) -> tuple[bool, SampleBatch]:
    """Whether a model wants start and goal is told only by its answers."""
    problem, query = _example(world), SampleQuery(10, 1, min_confidence=0.0, robot=robot_digest(world))
    png = picture_file_of(problem.scenario)
    try:
        return True, client.answer(png, between_ends(query, problem), model)
    except SamplerUnavailableError:
        raise
    except SamplerError:
        return False, client.answer(png, query, model)


def _opened(spec: SourceSpec, stack: ExitStack) -> SampleSource:
    if spec.packed is not None:
        # The sampler keeps what it needs in memory, and a worker that is ended would leave the folder behind.
        with TemporaryDirectory(prefix="cspace-bundle-") as folder:
            return LocalSampler(spec.packed.unpack(Path(folder)), name=spec.name)
    if spec.url is None:
        raise ConfigError("the sampler is neither a model nor a bundle", got=spec.name)
    return stack.enter_context(SamplingClient(spec.url))


def _example(world: World) -> Problem:
    return workshop_of(world).problem(UNIFORM, Split.DEMO, 0)
