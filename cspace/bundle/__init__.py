"""The deployable artefact: a folder of ONNX graphs with their description, sums and golden case."""

from cspace.bundle.files import GoldenCase
from cspace.bundle.load import Bundle, graphs_of, load_verified, write_bundle
from cspace.bundle.sampling import Encoding, OccupancyGrid, Picture, SampleSet
from cspace.bundle.spec import SCHEMA_VERSION, BundleSpec, Provenance, RandomInput
from cspace.query import MAX_EPSILON, MAX_SEED, SampleQuery

__all__ = [
    "MAX_EPSILON",
    "MAX_SEED",
    "SCHEMA_VERSION",
    "Bundle",
    "BundleSpec",
    "Encoding",
    "GoldenCase",
    "OccupancyGrid",
    "Picture",
    "Provenance",
    "RandomInput",
    "SampleQuery",
    "SampleSet",
    "graphs_of",
    "load_verified",
    "write_bundle",
]
