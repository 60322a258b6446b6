"""What draws the samples of a request, of any bundle."""

from typing import Protocol

from cspace.bundle.drawing.along_ways import WaySampler
from cspace.bundle.drawing.generated import GeneratorSampler
from cspace.bundle.request import FittedQuery
from cspace.bundle.running.chunks import Between
from cspace.bundle.running.graphs import Graph
from cspace.bundle.running.head import Head
from cspace.bundle.samples import Drawn, Picture
from cspace.bundle.spec import BundleSpec
from cspace.errors import BundleIntegrityError


class Sampler(Protocol):
    """Draws the samples of requests."""

    def draw(
        self, picture: Picture, request: FittedQuery, *, tell_confidence: bool, between: Between | None
    ) -> Drawn:
        """Samples for a picture; the same request gives bit-equal ones on one machine.

        Args:
            picture: that the bundle has prepared.
            request: fitted to the bundle.
            tell_confidence: whether samples are scored that are not filtered; the samples are the same.
            between: called now and then in a large request; may raise to stop it, which passes through.

        Raises:
            BundleError: a graph fails.
            ImportError: samples are searched for, and the compiler of the checks is not installed.
        """


def sampler_of(spec: BundleSpec, generator: Graph | None, head: Head | None) -> Sampler:
    """What draws for a bundle.

    Raises:
        BundleIntegrityError: samples are to lie along ways, and there is no head to choose among these.
    """
    if generator is not None:
        return GeneratorSampler(spec, generator, head)
    if head is None:
        raise BundleIntegrityError(
            "a bundle of ways has no validity head", expected="validity.onnx", got="none"
        )
    return WaySampler(spec, head)
